"""Datagrams of captures: link layers, tags, versions of IP, fragments."""

import pytest
from udp_captures import PORT, SOURCE, capture, ethernet, ipv4, ipv6, udp

from lidar_core.io.files.udp import MOST_PENDING, datagrams

PAYLOAD = bytes(range(256)) * 20


def fragments(make, size=1480, **values):
    whole = udp(PAYLOAD)
    starts = range(0, len(whole), size)
    return [
        make(whole[at : at + size], offset=at, more=at + size < len(whole), **values)
        for at in starts
    ]


@pytest.mark.parametrize("order", ["<", ">"])
@pytest.mark.parametrize(("magic", "unit"), [(0xA1B2C3D4, 1000), (0xA1B23C4D, 1)])
def test_both_orders_and_clocks(tmp_path, order, magic, unit):
    path = capture(tmp_path / "a.pcap", [ethernet(ipv4(udp(b"abc")))], order=order, magic=magic)
    (found,) = datagrams(path)
    assert found == (100 * 10**9 + 7 * unit, SOURCE, PORT, b"abc")


@pytest.mark.parametrize(
    ("link", "front"),
    [(101, b""), (228, b""), (0, bytes(4)), (108, bytes(4)), (113, bytes(16)), (276, bytes(20))],
)
def test_other_link_layers(tmp_path, link, front):
    (found,) = datagrams(capture(tmp_path / "a.pcap", [front + ipv4(udp(b"abc"))], link=link))
    assert found.data == b"abc"


def test_tags_options_and_ipv6(tmp_path):
    packets = [
        ethernet(ipv4(udp(b"a")), 0x8100),
        ethernet(ipv4(udp(b"b")), 0x88A8, 0x8100),
        ethernet(ipv4(udp(b"c"), options=bytes(4))),
        ethernet(ipv6(udp(b"d"))),
        ethernet(ipv4(udp(b"e")) + bytes(18)),  # Ethernet pads short frames
    ]
    found = list(datagrams(capture(tmp_path / "a.pcap", packets)))
    assert [one.data for one in found] == [b"a", b"b", b"c", b"d", b"e"]
    assert found[3].source == bytes(12) + SOURCE


@pytest.mark.parametrize("make", [ipv4, ipv6])
def test_fragments_are_put_together_in_any_order(tmp_path, make):
    parts = fragments(make, number=1) + fragments(make, number=2)
    mixed = [ethernet(parts[i]) for i in (5, 0, 7, 3, 1, 2, 4, 6)]
    assert len(parts) == len(mixed)
    found = list(datagrams(capture(tmp_path / "a.pcap", mixed)))
    assert [one.data for one in found] == [PAYLOAD, PAYLOAD]


@pytest.mark.parametrize("make", [ipv4, ipv6])
def test_a_lost_fragment_loses_its_datagram_alone(tmp_path, make):
    parts = fragments(make, number=1)[:-1] + fragments(make, number=2)[1:]
    parts += fragments(make, number=3)
    found = list(datagrams(capture(tmp_path / "a.pcap", map(ethernet, parts))))
    assert [one.data for one in found] == [PAYLOAD]


def test_lost_fragments_do_not_gather(tmp_path):
    """The oldest is given up: its last fragment comes too late."""
    first, *rest = fragments(ipv4, number=0)
    others = [fragments(ipv4, number=number)[0] for number in range(1, MOST_PENDING + 1)]
    packets = [ethernet(part) for part in (first, *others, *rest)]
    assert list(datagrams(capture(tmp_path / "a.pcap", packets))) == []
    packets = [ethernet(part) for part in (first, *others[:-1], *rest)]
    assert len(list(datagrams(capture(tmp_path / "a.pcap", packets)))) == 1


def test_what_is_no_whole_datagram_is_passed_over(tmp_path):
    whole = ethernet(ipv4(udp(b"abcdef")))
    packets = [
        ethernet(ipv4(udp(b"tcp"), protocol=6)),
        bytes(12) + b"\x08\x06" + bytes(28),  # ARP
        whole[:-3],  # cut by the capture
        ethernet(ipv4(b"\x00" * 5)),
        b"",
        ethernet(b"\x00" * 30),
    ]
    assert list(datagrams(capture(tmp_path / "a.pcap", packets))) == []
