"""A decoder that aborts, stalls or takes all memory ends in a line, and this process goes on."""

from pathlib import Path

import cv2
import numpy as np
import pytest

from gpgrad_core.errors import InputError
from gpgrad_core.reading import decoding
from gpgrad_core.reading.decoding import DecodingError, decode_apart
from gpgrad_core.reading.images import read_images

WITH = (
    "import os, sys; from gpgrad_core.reading import decoding; "
    "decoding.DECODERS['laz'] = lambda data: {}; sys.exit(decoding.main(*sys.argv[1:]))"
)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("does", "said"),
    [
        ("os.abort()", "its decoder died"),
        ("bytearray(1 << 40)", "MemoryError"),
        ("[None for _ in iter(int, 1)]", "takes more than [16] s"),  # 6 by the clock, under load
        ("1 / 0", "division by zero"),
        ("(_ for _ in ()).throw(BaseException('a panic'))", "a panic"),
        ("bytes(101)", "more than 100 bytes"),
    ],
)
def test_whatever_a_decoder_does_ends_in_a_line(
    does: str, said: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(decoding, "START", WITH.format(does))
    monkeypatch.setattr(decoding, "BASE_SECONDS", 1)
    with pytest.raises(DecodingError, match=said) as refusal:
        decode_apart("laz", b"", 100)
    assert "\n" not in str(refusal.value)


def test_a_decoder_that_sleeps_is_ended(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(decoding, "START", "import time; time.sleep(600)")
    monkeypatch.setattr(decoding, "BASE_SECONDS", 0.05)
    with pytest.raises(DecodingError, match=r"takes more than 0\.3"):
        decode_apart("laz", b"", 100)


def test_what_is_printed_does_not_mix_with_the_reply(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(decoding, "START", WITH.format("(print('hello'), data)[1]"))
    assert decode_apart("laz", b"abc", 100) == b"abc"


@pytest.mark.slow
def test_images_come_back_in_order(tmp_path: Path) -> None:
    pictures = [np.full((4 + k, 9), 10 * k, np.uint8) for k in range(6)]
    files = [tmp_path / f"{k}.png" for k in range(6)]
    for file, picture in zip(files, pictures, strict=True):
        cv2.imwrite(str(file), picture)
    for found, picture in zip(read_images(files), pictures, strict=True):
        np.testing.assert_array_equal(found, picture)
    files[4].write_bytes(b"no image")
    with pytest.raises(InputError, match=r"4\.png: is not an image"):
        list(read_images(files))
