"""The identity of a board: codes that are read from the frames of a run, and compared with ids from elsewhere.

A region of the board in which a code may be is drawn upright from the frame that shows it best, or from several where
no frame shows all of it. A region in which nothing was read is drawn again from other frames, and enlarged.
"""
