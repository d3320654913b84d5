"""Ways to break a file. Each takes its bytes and a random generator and returns other bytes."""

import bz2
import gzip
import io
import re
import struct
import zipfile
import zlib
from collections.abc import Callable
from functools import cache, lru_cache

import numpy as np

INTERESTING = (
    *(0, 1, 2, 3, 4, 7, 8, 16, 127, 128, 255, 256, 1000, 4096),
    *(2**15 - 1, 2**15, 2**16 - 1, 2**16, 2**24, 2**31 - 1, 2**31, 2**32 - 2, 2**32 - 1),
    *(2**32, 2**40, 2**62, 2**63 - 1, 2**63, 2**64 - 1, 10**9, 10**18),
)
WORDS = (
    *("1e308", "-1e308", "nan", "inf", "-inf", "-1", "0", "00", "1e-320", "0x10", "1_0", "٣"),
    *("9" * 20, "9" * 400, "1" + "0" * 5000, "4294967296", "9223372036854775808", "-0.0"),
    *("", " ", "true", "null", "[]", "{}", "[[" * 2000, '"', "'", "\x00", "\n\n", "\r", "\t", ";"),
)
TEXTS = (
    *(b"\xff\xfe", b"\xef\xbb\xbf", b"\x00" * 64, b"%n%s%x", b"../../../../etc/passwd"),
    *(b"\xed\xa0\x80", "ü€𝄞".encode(), b"<!-- -->", b"\n" * 500, b"a" * 70_000, b"-" * 300),
    *(b"\x1b[2J", b"__import__('os').abort()", b"!!python/object/apply:os.abort []"),
)
Mutator = Callable[[bytes, np.random.Generator], bytes]
MUTATORS: dict[str, Mutator] = {}


def mutator(function: Mutator) -> Mutator:
    MUTATORS[function.__name__] = function
    return function


def _place(data: bytes, rng: np.random.Generator, width: int = 1) -> int:
    """Where to strike: anywhere, or near one of the ends, where headers and tables are."""
    last = max(len(data) - width, 0)
    near = min(int(rng.choice([64, 512, 4096])), last)
    kind = rng.integers(4)
    if kind == 0:
        return last - int(rng.integers(near + 1))
    return int(rng.integers((near if kind < 3 else last) + 1))


def _written(data: bytes, at: int, new: bytes) -> bytes:
    return data[:at] + new + data[at + len(new) :]


@mutator
def flip_bits(data, rng):
    out = bytearray(data)
    for _ in range(int(rng.choice([1, 1, 2, 8, 64])) if out else 0):
        out[_place(data, rng)] ^= 1 << int(rng.integers(8))
    return bytes(out)


@mutator
def set_bytes(data, rng):
    value = int(rng.choice([0, 255, 128, 127, 32, 10]))
    return _written(data, _place(data, rng), bytes([value]) * int(rng.choice([1, 4, 8, 64, 1024])))


@mutator
def noise(data, rng):
    return _written(data, _place(data, rng), rng.bytes(int(rng.choice([2, 16, 256, 5000]))))


@mutator
def cut(data, rng):
    return data[: _place(data, rng)]


@mutator
def cut_front(data, rng):
    return data[_place(data, rng) :]


@mutator
def drop_block(data, rng):
    at = _place(data, rng)
    return data[:at] + data[at + int(rng.choice([1, 2, 4, 100, 4096])) :]


@mutator
def double_block(data, rng):
    at, size = _place(data, rng), int(rng.choice([1, 4, 64, 4096, 20_000]))
    return (
        data[: at + size] + data[at : at + size] * int(rng.choice([1, 1, 40])) + data[at + size :]
    )


@mutator
def swap_blocks(data, rng):
    size = int(rng.choice([1, 4, 64, 1024]))
    a, b = sorted((_place(data, rng, size), _place(data, rng, size)))
    if b - a < size:
        return data[::-1]
    return (
        data[:a] + data[b : b + size] + data[a + size : b] + data[a : a + size] + data[b + size :]
    )


@mutator
def wrong_number(data, rng):
    """A count, size or offset of 1 to 8 bytes becomes an interesting one."""
    for _ in range(int(rng.integers(1, 4))):
        width, order = int(rng.choice([1, 2, 4, 4, 8, 8])), str(rng.choice(["little", "big"]))
        value = INTERESTING[rng.integers(len(INTERESTING))] % 2 ** (8 * width)
        at = _place(data, rng, width)
        at -= at % int(rng.choice([1, width]))
        data = _written(data, at, value.to_bytes(width, order))
    return data


@mutator
def shifted_number(data, rng):
    """A number that is there becomes a slightly different, or a much greater one."""
    width = int(rng.choice([1, 2, 4, 8]))
    at = _place(data, rng, width)
    value = int.from_bytes(data[at : at + width], "little")
    factor, more = int(rng.choice([1, 1, 2, 256, 65536])), int(rng.choice([-8, -1, 1, 4, 100]))
    return _written(data, at, (value * factor + more).__mod__(256**width).to_bytes(width, "little"))


@mutator
def wrong_float(data, rng):
    form = str(rng.choice(["<f", "<d", ">f", ">d"]))
    value = float(rng.choice([np.nan, np.inf, -np.inf, 1e38, -1e38, 1e-45, -0.0, 1e19]))
    at = _place(data, rng, 8)
    for step in range(int(rng.choice([1, 3, 40]))):
        data = _written(data, at + step * struct.calcsize(form), struct.pack(form, value))
    return data


@mutator
def other_endianness(data, rng):
    """A stretch, or all of it, with its words the other way round."""
    width = int(rng.choice([2, 4, 8]))
    whole = rng.random() < 0.3
    at = 0 if whole else _place(data, rng)
    size = (len(data) - at if whole else min(len(data) - at, 1024)) // width * width
    words = np.frombuffer(data, f"<u{width}", size // width, at)
    return _written(data, at, words.byteswap().tobytes())


@mutator
def inject_text(data, rng):
    at = _place(data, rng)
    return data[:at] + TEXTS[rng.integers(len(TEXTS))] + data[at:]


@mutator
def wrong_word(data, rng):
    """A number or word of a text becomes another: huge, negative, not a number, nothing."""
    found = list(re.finditer(rb"-?[0-9][0-9.eE+-]*|[A-Za-z_]{2,}", data[:200_000]))
    for _ in range(int(rng.integers(1, 3)) if found else 0):
        one = found[min(int(rng.exponential(40)), len(found) - 1)]
        if rng.random() < 0.5:
            one = found[rng.integers(len(found))]
        word = WORDS[rng.integers(len(WORDS))].encode()
        data = data[: one.start()] + word + data[one.end() :]
        found = list(re.finditer(rb"-?[0-9][0-9.eE+-]*|[A-Za-z_]{2,}", data[:200_000])) or found[:0]
        if not found:
            break
    return data


@mutator
def lines_astray(data, rng):
    lines = data.split(b"\n")
    a, b = (int(rng.integers(len(lines))) for _ in range(2))
    lines[a], lines[b] = lines[b], lines[a]
    del lines[int(rng.integers(len(lines)))]
    return b"\n".join(lines + lines[a : a + 3])


@mutator
def twice(data, rng):
    return data + data


@mutator
def longer(data, rng):
    return data + [bytes(4096), rng.bytes(300), data[:100], b"\xff" * 9][rng.integers(4)]


@mutator
def nothing_but(data, rng):
    size = int(rng.choice([0, 1, 3, 8, 64, 5000]))
    return [bytes(size), b"\xff" * size, rng.bytes(size), b"0 " * size, data[:size]][
        rng.integers(5)
    ]


@mutator
def head_of_another_size(data, rng):
    return data[: int(rng.integers(1, 200))] + bytes(int(rng.choice([0, 1, 100, 100_000])))


@mutator
def bomb(data, rng):
    """Data that expands to 256 MiB, in place of the file or behind its first bytes."""
    size = 2**28
    if data[:2] == b"PK":
        return _zip_bomb(data, size)
    packed = _packed_zeros("bz2" if data[:3] == b"BZh" or rng.random() < 0.4 else "gzip", size)
    return packed if rng.random() < 0.5 else data[: _place(data, rng)] + packed


@cache  # it takes seconds, and all files get the same
def _packed_zeros(how: str, size: int) -> bytes:
    if how == "gzip":
        return gzip.compress(bytes(size >> 4))
    packer = bz2.BZ2Compressor()
    return b"".join(packer.compress(bytes(2**20)) for _ in range(size >> 20)) + packer.flush()


@lru_cache(100)  # for the same reason, most archives being whole here
def _zip_bomb(data: bytes, size: int) -> bytes:
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        names = archive.namelist()
        heads = {name: archive.read(name)[:128] for name in names}
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w", zipfile.ZIP_DEFLATED) as archive:
        for name in names:
            with archive.open(name, "w", force_zip64=True) as member:
                member.write(heads[name])
                for _ in range(size >> 20 if name == names[0] else 0):
                    member.write(bytes(2**20))
    return out.getvalue()


# Behind a checksum or a compression: what is inside is broken, and the outside is right again.


def rezipped(data: bytes, rng: np.random.Generator, inner: Mutator) -> bytes:
    """A zip archive (.npz) with one member broken."""
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        members = {one.filename: archive.read(one) for one in archive.infolist()}
    name = list(members)[rng.integers(len(members))]
    kind = rng.integers(8)
    if kind == 0:
        del members[name]
    elif kind == 1:
        members[name] = members[list(members)[rng.integers(len(members))]]
    else:
        members[name] = inner(members[name], rng)
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w") as archive:
        for key, content in members.items():
            archive.writestr(key, content)
    return out.getvalue()


def recompressed(data: bytes, rng: np.random.Generator, inner: Mutator) -> bytes:
    """A bz2, gzip or zstd file whose content is broken."""
    if data[:3] == b"BZh":
        return bz2.compress(inner(bz2.decompress(data), rng), 1)
    if data[:2] == b"\x1f\x8b":
        return gzip.compress(inner(gzip.decompress(data), rng))
    import zstandard

    plain = zstandard.ZstdDecompressor().decompressobj().decompress(data)
    return zstandard.ZstdCompressor().compress(inner(plain, rng))


def resealed(data: bytes, rng: np.random.Generator, inner: Mutator) -> bytes:
    """A saved state or map, broken within, whose CRC-32 at the end is right again."""
    body = inner(data[:-4], rng)
    core = body.find(b"LCFS")
    if core > 0 and len(body) > core + 20:  # the state of the core has a checksum of its own
        body = body[:-4] + struct.pack("<I", zlib.crc32(body[core:-4]))
    return body + struct.pack("<I", zlib.crc32(body))


def inside(data: bytes) -> Callable[[bytes, np.random.Generator, Mutator], bytes] | None:
    """What breaks the inside of such a file; None if nothing covers it."""
    if data[:2] == b"PK":
        return rezipped
    if data[:3] == b"BZh" or data[:2] == b"\x1f\x8b" or data[:4] == b"\x28\xb5\x2f\xfd":
        return recompressed
    return resealed if data[:4] in (b"LCST", b"LCVM") else None


def mutated(data: bytes, rng: np.random.Generator) -> tuple[str, bytes]:
    """A broken file, and how it was broken: one to three ways, half the time behind the seal."""
    names = list(MUTATORS)
    around = inside(data)
    told = []
    for _ in range(int(rng.choice([1, 1, 1, 2, 3]))):
        name = names[rng.integers(len(names))]
        if around is not None and rng.random() < 0.6:
            try:
                data = around(data, rng, MUTATORS[name])
                told.append(f"{around.__name__}({name})")
                continue
            except Exception:
                pass
        try:
            data = MUTATORS[name](data, rng)
        except (zipfile.BadZipFile, zlib.error, ValueError, IndexError, OSError, EOFError):
            data = flip_bits(data, rng)
        told.append(name)
    return "+".join(told), data
