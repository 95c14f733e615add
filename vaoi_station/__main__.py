"""`python -m vaoi_station` is the same as `vaoi`."""

from vaoi_station.cli import main

main()
