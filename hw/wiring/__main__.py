"""`python -m hw.wiring`: drawings, tables and lists made anew from circuit.toml and the firmware's limits."""

from hw.wiring.pages import write

if __name__ == "__main__":
    write()
