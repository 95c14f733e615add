"""Which split a board belongs to: by a digest of its id, so that no board is in two splits, also in later calls."""

from __future__ import annotations

from dataclasses import dataclass
from hashlib import sha256

from vaoi_station.errors import InputError

DEFAULT = "train=0.8,val=0.1,test=0.1"
RESERVED = "annotations"
"""Name of a directory of every COCO data set."""


@dataclass(frozen=True)
class Splits:
    """Names of the splits, with the share of the boards that each gets."""

    shares: tuple[tuple[str, float], ...]

    @staticmethod
    def of(text: str) -> Splits:
        """Parse `train=0.8,val=0.1,test=0.1`. Raise InputError unless the shares are positive and add up to 1."""
        pairs = [part.partition("=") for part in text.split(",")]
        try:
            shares = tuple((name.strip(), float(share)) for name, _, share in pairs)
        except ValueError:
            shares = ()
        names = [name for name, _ in shares]
        usable = all(name.isidentifier() for name in names) and len(set(names)) == len(names)
        if not shares or not usable or not all(0 < share <= 1 for _, share in shares):
            raise InputError.field("vaoi dataset", "--splits", text, f"names with shares, such as {DEFAULT}")
        if RESERVED in names:
            raise InputError.field(
                "vaoi dataset", "--splits", text, f"names other than {RESERVED}, a directory of COCO"
            )
        if abs(sum(share for _, share in shares) - 1) > 1e-9:
            raise InputError.field("vaoi dataset", "--splits", text, "shares that add up to 1")
        return Splits(shares)

    def of_board(self, board: str) -> str:
        """Return the split of a board."""
        at = int.from_bytes(sha256(board.encode()).digest()[:8], "big") / 2**64
        for name, share in self.shares:
            if at < share:
                return name
            at -= share
        return self.shares[-1][0]  # shares of floating-point numbers may add up to a little less than 1
