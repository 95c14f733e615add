"""The acquisition process: open devices, film boards, report to the station over one pipe."""
