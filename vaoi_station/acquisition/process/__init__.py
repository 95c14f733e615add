"""Run the acquisition process: open devices, film boards, report to the station."""
