"""`vaoi demo`: the whole service on the digital twin, and a program that uses it as tester software would.

The service runs in a process of its own; everything here but its start and its end goes over REST.
"""
