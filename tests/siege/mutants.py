"""Seeded mutants: bytes hurt blindly, and content that lies inside a frame whose checksums are right."""

import hashlib
import io
import json
import struct
import zipfile
import zlib

import h5py
import numpy as np

from ultraquiet.files import archive
from ultraquiet.files.frames import DATA, END, HEADER, LogFrame, UnsoundError, frame_at

WORDS = (0, 1, 2, 7, 255, 256, 65535, 2**16, 2**24, 2**31 - 1, 2**31, 2**32 - 1)
NASTY = (
    None,
    True,
    -1,
    0,
    2**70,
    1e308,
    float("nan"),
    float("inf"),
    "",
    "x" * 5000,
    "../victim",
    "/etc/passwd",
    "\x00",
    "\x1b[2J",
    "\ud800",
    "²",
    [],
    {},
    [[]],
    {"a": {}},
    [[[[[[[[[[[]]]]]]]]]]],
)
TOKENS = (
    "nan", "inf", "-1", "0", "1e999", "1_0", '"x"', "[]", "{}", "[[", "]]", "=", "true", "\x00", "²", "9" * 20,
    "-0.0", '"../../etc/passwd"', "'''", "#", "\n", '"\\uD800"', "1979-05-27", "\ufeff", "\u202e", '""',
)  # fmt: skip


def pick(rng, items):
    return items[int(rng.integers(len(items)))]


def hurt(rng, data, other=b""):
    """Return bytes with flips, cuts, copies, words set to extremes, or a stretch of another file."""
    data = bytearray(data)
    for _ in range(int(rng.integers(1, 4))):
        if not data:
            break
        at, length = int(rng.integers(len(data))), int(rng.geometric(0.05))
        kind = int(rng.integers(8))
        if kind <= 1:
            data[at] ^= 1 << int(rng.integers(8))
        elif kind == 2:
            data[at : at + length] = rng.integers(0, 256, length, dtype=np.uint8).tobytes()
        elif kind == 3:
            del data[at : at + length]
        elif kind == 4:
            data[at:at] = data[at : at + length]
        elif kind == 5:
            at -= at % 4
            data[at : at + 4] = struct.pack(pick(rng, ("<I", ">I")), pick(rng, WORDS))
        elif kind == 6:
            del data[at:]
        else:
            start = int(rng.integers(max(len(other), 1)))
            data[at : at + length] = other[start : start + length]
    return bytes(data)


def retold(rng, text):
    """Return a text with numbers, words or lines replaced, doubled or dropped."""
    lines = text.split("\n")
    for _ in range(int(rng.integers(1, 3))):
        at = int(rng.integers(len(lines)))
        words = lines[at].split(" ")
        kind = int(rng.integers(5))
        if kind == 0:
            lines.insert(at, lines[at])
        elif kind == 1 and len(lines) > 1:
            del lines[at]
        elif kind == 2:
            lines[at] += pick(rng, TOKENS)
        else:
            words[int(rng.integers(len(words)))] = pick(rng, TOKENS)
            lines[at] = " ".join(words)
    return "\n".join(lines)


def lied(rng, content):
    """Return a JSON value with one of its parts replaced, dropped or put where none belongs."""
    if rng.random() < 0.15 or not isinstance(content, dict | list) or not content:
        return pick(rng, NASTY)
    if isinstance(content, dict):
        key = pick(rng, sorted(content))
        changed = dict(content)
        if rng.random() < 0.2:
            del changed[key]
        elif rng.random() < 0.2:
            changed[str(pick(rng, NASTY))[:100]] = pick(rng, NASTY)
        else:
            changed[key] = lied(rng, content[key])
        return changed
    at = int(rng.integers(len(content)))
    return [*content[:at], lied(rng, content[at]), *content[at + (rng.random() < 0.8) :]]


def sealed(image):
    return image + archive.SEAL + hashlib.sha256(image).hexdigest().encode()


def false_archive(rng, data):
    """Return an archive that is sealed again after its HDF5 was hurt, or after its content was made to lie."""
    image = data[: -len(archive.SEAL) - 64]
    if rng.random() < 0.5:
        return sealed(hurt(rng, image, image))
    memory = io.BytesIO(image)
    with h5py.File(memory, "r+") as file:
        group = file[pick(rng, list(file))]
        key, kind = pick(rng, list(group)), int(rng.integers(7))
        if kind == 0:
            del group[key]
        elif kind == 1:
            group["again"] = pick(rng, (group, h5py.SoftLink("/value"), h5py.ExternalLink("x.h5", "/")))
        elif kind == 2:
            group.attrs["kind"] = pick(rng, ("record", "state-space", "nothing", 3, np.zeros(3)))
        elif kind == 3:
            file.attrs["format_version"] = pick(rng, (0, 99, "one", np.zeros(2), -1))
        elif isinstance(group[key], h5py.Dataset) and h5py.check_string_dtype(group[key].dtype):
            text = group[key].asstr()[()]
            del group[key]
            group[key] = json.dumps(lied(rng, json.loads(text)))
        else:
            del group[key]
            shapes = (
                np.zeros(()),
                np.zeros((0, 5)),
                np.full((1, 5), np.nan),
                np.zeros((2, 3, 4)),
                b"text",
                np.zeros(3, int),
            )
            group[key] = pick(rng, shapes)
    return sealed(memory.getvalue())


def frames(data):
    at, found = 0, []
    while at < len(data):
        try:
            frame = frame_at(data, at)
        except UnsoundError:
            break
        found.append(frame)
        at += frame.size
    return found


def false_log(rng, data):
    """Return a log whose frames were dropped, doubled, changed in content or in head, all with right checksums."""
    found = frames(data)
    at, kind = int(rng.integers(len(found))), int(rng.integers(4))
    frame = found[at]
    if kind == 0:
        del found[at]
    elif kind == 1:
        found.insert(at, frame)
    elif kind == 2 or frame.kind == DATA:
        told = dict(vars(frame))
        told[pick(rng, ("sequence", "offset", "channels", "samples"))] = int(pick(rng, WORDS))
        if rng.random() < 0.2:
            told["kind"] = pick(rng, (HEADER, DATA, END, b"Z"))
        found[at] = LogFrame(**told)
    else:
        content = lied(rng, json.loads(bytes(frame.payload)))
        found[at] = LogFrame(**{**vars(frame), "payload": json.dumps(content).encode()})
    return b"".join(frame.packed() for frame in found)


def false_journal(rng, data):
    lines = [json.loads(line[9:]) for line in data.splitlines()]
    at = int(rng.integers(len(lines)))
    lines[at] = lied(rng, lines[at])
    bodies = [json.dumps(line).encode() for line in lines]
    return b"".join(b"%08x %s\n" % (zlib.crc32(body), body) for body in bodies)


def false_zip(rng, data):
    """Return an archive of arrays with members hurt, renamed, doubled or dropped, and sums that are right again."""
    memory, held = io.BytesIO(), zipfile.ZipFile(io.BytesIO(data))
    members = {name: held.read(name) for name in held.namelist()}
    name = pick(rng, sorted(members))
    kind = int(rng.integers(4))
    if kind == 0:
        members[pick(rng, ("../../u.npy", "u", "a\x01.npy", "x" * 300 + ".npy"))] = members.pop(name)
    elif kind == 1:
        del members[name]
    elif kind == 2:
        members[name] = (
            retold(rng, members[name][:128].decode("latin-1")).encode("latin-1", "replace") + members[name][128:]
        )
    else:
        members[name] = hurt(rng, members[name])
    with zipfile.ZipFile(memory, "w", zipfile.ZIP_DEFLATED) as out:
        for member, content in members.items():
            out.writestr(member, content)
    return memory.getvalue()


def false_mat(rng, data):
    """Return a MAT file of version 5 whose compressed variables were hurt inside and packed again."""
    parts, at = [data[:128]], 128
    while at + 8 <= len(data):
        kind, size = struct.unpack_from("<II", data, at)
        body = data[at + 8 : at + 8 + size]
        if kind == 15 and rng.random() < 0.4:
            body = zlib.compress(hurt(rng, zlib.decompress(body)))
        parts.append(struct.pack("<II", kind, len(body)) + body)
        at += 8 + size
    return b"".join(parts)


def false_hdf5(rng, data):
    """Return another program's HDF5 with odd attributes, names, shapes or kinds."""
    memory = io.BytesIO(data)
    with h5py.File(memory, "r+") as file:
        name = pick(rng, list(file))
        kind = int(rng.integers(5))
        if kind == 0:
            file.attrs["fs"] = pick(rng, (0.0, -1.0, np.nan, np.inf, np.zeros(3), "ten", np.zeros(0)))
        elif kind == 1:
            file[name].attrs[pick(rng, ("units", "names"))] = pick(rng, (3, np.zeros(3), "x", b"\xff\xfe", ""))
        elif kind == 2:
            del file[name]
            file[name] = pick(rng, (np.zeros(()), np.zeros((0, 3)), np.zeros((2, 2, 2)), b"t", np.array([1 + 2j])))
        elif kind == 3:
            file["group"] = file["/"]
        else:
            file.move(name, pick(rng, ("\x1b[2J", "ü", "x" * 1000, "time", "fs")))
    return memory.getvalue()
