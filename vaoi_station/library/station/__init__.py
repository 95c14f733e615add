"""Parts of the client of a running station: one run, and the board types, blocking and for asyncio."""
