"""What an emulated bus does to the answers on it, switched on and off while it runs."""

from __future__ import annotations

import time
from dataclasses import dataclass


@dataclass
class Faults:
    """
    What is wrong with the answers at the moment.

    Parameters
    ----------
    spoilt, cut, doubled : int
        How many of the next answers get a wrong CRC, lose their second half, come twice.
    delay : float
        Before every answer [s].
    """

    spoilt: int = 0
    cut: int = 0
    doubled: int = 0
    delay: float = 0.0

    def on_the_way(self, answer: bytes) -> bytes:
        """Do to an answer what the bus does to it."""
        if not answer:
            return answer
        if self.delay:
            time.sleep(self.delay)
        if self.spoilt:
            self.spoilt -= 1
            answer = answer[:-1] + bytes([answer[-1] ^ 0x5A])
        if self.cut:
            self.cut -= 1
            answer = answer[: len(answer) // 2]
        if self.doubled:
            self.doubled -= 1
            answer += answer
        return answer
