"""Run the whole service on the digital twin, and use it by REST as tester software would (`vaoi demo`)."""
