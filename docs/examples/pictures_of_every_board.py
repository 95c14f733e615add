"""Every picture of every board that passes: python pictures_of_every_board.py http://127.0.0.1:8350 BOARD_TYPE COUNT

Arms the station, waits for COUNT boards, and shows how many pictures each has. On another machine than the station:
VAOI_KEY_FILE=tester.key VAOI_CA=ca.pem; the key needs the scopes read and operate.
"""

import asyncio
import sys

import vaoi_station as vaoi

address, board_type, count = sys.argv[1], sys.argv[2], int(sys.argv[3])


async def main() -> None:
    """Wait for each board, and read its pictures."""
    station = await vaoi.connect_async(address)
    newest = (await station.runs(limit=1) or [{"id": None}])[0]["id"]
    await station.arm(board_type, runs=count)
    for _ in range(count):
        run = None
        while run is None:
            run = await station.wait_for_run(after=newest)
        newest = run.id
        pictures = 0
        async for component in run.pictures(limit=3):
            pictures += len(component.pixels)  # your evaluation: component.address, .views[k], .pixels[k]
        print(f"run {run.id}: {run.summary['verdict']}, {pictures} pictures")
        await run.release()


asyncio.run(main())
