"""The virtual rig: run the station's real backends on devices that are emulated down to registers and network packets.

`run.run_rig` is `vaoi rig run`, `run.run_until_interrupted` is `vaoi rig up`.
"""
