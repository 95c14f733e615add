"""`python -m hw.wiring`: write the drawings, tables and lists again from circuit.toml and the firmware's limits."""

from hw.wiring.pages import write

if __name__ == "__main__":
    write()
