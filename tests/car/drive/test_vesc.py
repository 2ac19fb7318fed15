"""The motor controller's protocol: byte vectors, resynchronisation, and that nothing makes the decoder raise."""

from __future__ import annotations

import struct

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from targets.car.drive import vesc


def bitwise_crc(data: bytes) -> int:
    """CRC-16/XMODEM from its definition, as a reference."""
    crc = 0
    for byte in data:
        crc ^= byte << 8
        for _ in range(8):
            crc = (crc << 1 ^ 0x1021 if crc & 0x8000 else crc << 1) & 0xFFFF
    return crc


def test_the_checksum_is_xmodem() -> None:
    assert vesc.checksum(b"123456789") == 0x31C3
    assert all(vesc.checksum(bytes([i, 255 - i])) == bitwise_crc(bytes([i, 255 - i])) for i in range(256))


@pytest.mark.parametrize(
    ("message", "payload"),
    [
        (vesc.AskValues(), "04"),
        (vesc.AskVersion(), "00"),
        (vesc.Version(6, 5), "00 06 05"),
        (vesc.SetErpm(1000.0), "08 00 00 03 e8"),
        (vesc.SetErpm(-4614.0), "08 ff ff ed fa"),
        (vesc.SetServo(0.5304), "0c 02 12"),
        (vesc.Brake(10.0), "07 00 00 27 10"),
    ],
)
def test_payloads(message: vesc.Message, payload: str) -> None:
    data = bytes.fromhex(payload)
    assert vesc.encode(message) == bytes([2, len(data)]) + data + struct.pack(">H", bitwise_crc(data)) + b"\x03"


def test_the_frame_that_every_vesc_tool_sends_first() -> None:
    assert vesc.encode(vesc.AskValues()) == bytes.fromhex("02 01 04 40 84 03")


def test_numbers_beyond_a_field_go_to_its_end_and_nan_is_refused() -> None:
    assert vesc.encode(vesc.SetErpm(1e300))[3:7] == b"\x7f\xff\xff\xff"
    assert vesc.encode(vesc.SetServo(7.0))[3:5] == struct.pack(">h", 1000)
    assert vesc.encode(vesc.SetServo(-7.0))[3:5] == struct.pack(">h", 0)
    with pytest.raises(ValueError, match="not a number"):
        vesc.encode(vesc.SetErpm(float("nan")))


def test_values_are_found_where_the_firmware_puts_them() -> None:
    # A reply of firmware 5 written by hand: temperatures, currents, duty, ERPM 3210, 12.6 V, ..., fault 3, and what
    # newer firmware appends.
    payload = bytes([4]) + struct.pack(">hh4ih", 251, 300, 120, 80, 0, 0, 55) + struct.pack(">ih", 3210, 126)
    payload += struct.pack(">6i", 1, 2, 3, 4, 5, 6) + bytes([3]) + bytes(17)
    assert vesc.Decoder().feed(vesc.frame(payload)) == [vesc.Values(3210.0, 12.6, 3)]


messages = st.one_of(
    st.builds(vesc.SetErpm, st.integers(-(2**31) + 1, 2**31 - 1).map(float)),
    st.builds(vesc.SetServo, st.integers(0, 1000).map(lambda n: n / 1000)),
    st.builds(vesc.Brake, st.integers(0, 60000).map(lambda n: n / 1000)),
    st.just(vesc.AskValues()),
    st.just(vesc.AskVersion()),
    st.builds(vesc.Version, st.integers(0, 255), st.integers(0, 255)),
    st.builds(vesc.Values, st.integers(-99999, 99999).map(float), st.integers(0, 600).map(lambda n: n / 10)),
)


@given(st.lists(messages, max_size=8), st.integers(1, 40))
def test_what_was_encoded_comes_out_whatever_the_pieces(sent: list[vesc.Message], size: int) -> None:
    stream = b"".join(map(vesc.encode, sent))
    decoder = vesc.Decoder()
    got = [m for i in range(0, len(stream), size) for m in decoder.feed(stream[i : i + size])]
    assert got == sent
    assert decoder.dropped == 0


@given(st.binary(max_size=60), messages)
def test_after_noise_it_finds_its_feet_again(noise: bytes, last: vesc.Message) -> None:
    # Noise that looks like the start of a frame may swallow what follows it until the frame it promised is complete.
    stream = noise + vesc.encode(last) * 200
    assert vesc.Decoder().feed(stream)[-20:] == [last] * 20


@settings(max_examples=300)
@given(st.lists(st.binary(max_size=200), max_size=10))
def test_nothing_makes_it_raise_or_hoard(pieces: list[bytes]) -> None:
    decoder = vesc.Decoder()
    for piece in pieces:
        decoder.feed(piece)
        assert len(decoder._bytes) <= vesc.LARGEST + 6


@given(messages, st.data())
def test_a_damaged_frame_gives_no_message(message: vesc.Message, data: st.DataObject) -> None:
    frame = bytearray(vesc.encode(message))
    frame[data.draw(st.integers(0, len(frame) - 1))] ^= 1 << data.draw(st.integers(0, 7))
    assert message not in vesc.Decoder().feed(bytes(frame))


@given(st.binary(min_size=1, max_size=80))
def test_well_framed_nonsense_is_passed_over(payload: bytes) -> None:
    for message in vesc.Decoder().feed(vesc.frame(payload)):
        assert payload[0] in (0, 4, 7, 8, 12), message
