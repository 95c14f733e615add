"""Batches: the pictures of many components of a run in one answer.

The work is cut into *parts*. A worker chooses, renders, encodes and packs the pictures of a part, so that the station
only passes bytes on. A worker ends a part when it is large or has taken long, and states where the next one begins:
memory is bounded by the size of a part, and matrices never wait long behind pictures.
"""
