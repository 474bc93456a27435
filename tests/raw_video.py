"""A raw H.264 stream of grey frames: each macroblock holds its pixels as they are (I_PCM), so decoding is exact."""

import numpy as np


def h264(frames):
    """The bytes of a stream without times of grey frames `(F, h, w)`, whose sides are multiples of 16."""
    height, width = frames[0].shape
    sides = _ue(width // 16 - 1) + _ue(height // 16 - 1)
    sequence = bytes([66, 0, 40]) + _packed(_ue(0) + _ue(0) + _ue(2) + _ue(1) + "0" + sides + "1100" + "1")
    picture = _packed(
        _ue(0) + _ue(0) + "00" + _ue(0) + _ue(0) + _ue(0) + "000" + _ue(0) + _ue(0) + _ue(0) + "100" + "1"
    )
    stream = _unit(0x67, sequence) + _unit(0x68, picture)
    for number, frame in enumerate(frames):
        head = _ue(0) + _ue(7) + _ue(0) + "0000" + _ue(number % 2) + "00" + _ue(0) + _ue(1)
        blocks = frame.reshape(height // 16, 16, width // 16, 16).swapaxes(1, 2).reshape(-1, 256)
        pixels = [bytes(block) + b"\x80" * 128 for block in blocks]
        stream += _unit(0x65, _packed(head + _ue(25)) + _packed(_ue(25)).join(pixels) + b"\x80")
    return stream


def _ue(number):
    """Exp-Golomb code."""
    bits = f"{number + 1:b}"
    return "0" * (len(bits) - 1) + bits


def _packed(bits):
    bits += "0" * (-len(bits) % 8)
    return np.packbits(np.array(list(bits), dtype=np.uint8)).tobytes()


def _unit(kind, payload):
    """A unit with its start code; three bytes that look like one get a byte between them."""
    out, zeros = bytearray(), 0
    for byte in payload:
        if zeros >= 2 and byte <= 3:
            out.append(3)
            zeros = 0
        out.append(byte)
        zeros = zeros + 1 if byte == 0 else 0
    return b"\0\0\0\1" + bytes([kind]) + bytes(out)
