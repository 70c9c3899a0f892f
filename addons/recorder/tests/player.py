"""A sensor that plays frames on a pseudo terminal, as a process or in a thread."""

import binascii
import os
import pty
import sys
import threading
import time
import tty

import numpy as np


def add_cobs(content):
    """Frame a packet, as a sketch does: each zero becomes the distance to the next one."""
    out, block = bytearray(), bytearray()
    for byte in content + b"\0":
        if byte == 0:
            out += bytes([len(block) + 1]) + block
            block.clear()
        else:
            block.append(byte)
            if len(block) == 254:
                out += bytes([255]) + block
                block.clear()
    return bytes(out) + b"\0"


def as_line(number, values):
    """A frame as numbers with a counter."""
    return (",".join(map(str, [number, *values])) + "\n").encode()


def as_packet(number, values):
    """A frame as a packet."""
    content = np.array([number % 65536, *values], "<u2").tobytes()
    check = binascii.crc_hqx(content, 0xFFFF).to_bytes(2, "little")
    return add_cobs(content + check)


class Player(threading.Thread):
    """Play frames [n, channels] at a rate until they end; ``change`` may alter what is sent."""

    def __init__(self, frames, rate_hz, encode=as_line, change=lambda number, content: content):
        super().__init__(daemon=True)
        self.frames, self.rate_hz, self.encode, self.change = frames, rate_hz, encode, change
        self.master, self.slave = pty.openpty()
        tty.setraw(self.slave)
        self.port = os.ttyname(self.slave)
        self.is_over = False

    def run(self):
        """Send each frame when its time has come."""
        begin = time.monotonic()
        for number, values in enumerate(self.frames.tolist()):
            if self.is_over:
                return
            time.sleep(max(0.0, begin + number / self.rate_hz - time.monotonic()))
            if content := self.change(number, self.encode(number, values)):
                os.write(self.master, content)


if __name__ == "__main__":
    frames = np.load(sys.argv[1])
    player = Player(frames, float(sys.argv[2]))
    print(player.port, flush=True)
    player.run()
