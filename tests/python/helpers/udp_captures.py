"""Made packet captures: UDP over IPv4 and IPv6."""

import struct

SOURCE, TARGET, PORT = bytes([10, 0, 0, 2]), bytes([10, 0, 0, 1]), 7502


def udp(data, port=PORT):
    return struct.pack(">HHHH", 7502, port, len(data) + 8, 0) + data


def ipv4(part, *, offset=0, more=False, number=1, protocol=17, options=b""):
    place = offset // 8 | (0x2000 if more else 0)
    head = 20 + len(options)
    return (
        struct.pack(
            ">BBHHHBBH", 0x40 | head // 4, 0, head + len(part), number, place, 64, protocol, 0
        )
        + SOURCE
        + TARGET
        + options
        + part
    )


def ipv6(part, *, offset=0, more=None, number=1):
    following = 17
    if more is not None:
        part = struct.pack(">BBHI", 17, 0, offset | more, number) + part
        following = 44
    address = bytes(12)
    return (
        struct.pack(">IHBB", 6 << 28, len(part), following, 64)
        + address
        + SOURCE
        + address
        + TARGET
        + part
    )


def ethernet(packet, *tags):
    kind = struct.pack(">H", 0x86DD if packet[0] >> 4 == 6 else 0x0800)
    return bytes(12) + b"".join(struct.pack(">HH", tag, 5) for tag in tags) + kind + packet


def capture(path, packets, *, link=1, order="<", magic=0xA1B2C3D4):
    data = struct.pack(f"{order}IHHiIII", magic, 2, 4, 0, 0, 262_144, link)
    for number, packet in enumerate(packets):
        data += struct.pack(f"{order}IIII", 100 + number, 7, len(packet), len(packet)) + packet
    path.write_bytes(data)
    return path
