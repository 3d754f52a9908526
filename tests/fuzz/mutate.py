"""Inputs made worse: bytes, documents, arrays, XML and command lines."""

# ruff: noqa: E501  tables of nasty values
from __future__ import annotations

import copy
import io
import json
import random
import zipfile
from collections.abc import Callable
from typing import Any
from xml.etree import ElementTree

import numpy as np

NASTY: list[Any] = [
    *(
        None,
        True,
        False,
        "",
        " ",
        "x",
        "nan",
        "inf",
        "1e999",
        "\x00",
        "é\u2028",
        "\ud7ff",
        "a" * 5000,
        "../../etc/passwd",
    ),
    *(
        0,
        -1,
        1,
        2,
        3,
        7,
        1e-320,
        -1e-320,
        1e-9,
        0.5,
        1e9,
        1.1e9,
        1e15,
        1e154,
        1e200,
        1e308,
        -1e308,
        2**31,
        2**63,
        10**25,
    ),
    *(10**400, float("nan"), float("inf"), float("-inf"), 0.1 + 1e-12, 1000000, 99999, 1e-3),
    *(
        [],
        {},
        [[]],
        [{}],
        [None],
        [[[[1]]]],
        {"a": 1},
        {"": None},
        [0] * 1000,
        [[0, 0]] * 300,
        ["x"],
        {"normal": {"mu": 0, "sd": 1}},
    ),
]
RULES = [
    "x ** 8",
    "x * x * x * y",
    "cos(cos(x))",
    "((((" * 50,
    "x" + " + x" * 3000,
    "-" * 3000 + "x",
    "1e400",
    "x / 0",
    "x ** -1",
    "cos(1e308 * x)",
]
TOKENS = [b"\x00", b"\xff\xfe", b"\r", b"&a", b"*a", b"!!python/object:os.system", b"---\n", b"<!DOCTYPE a>", b"]]>", b"{", b"[", b"}", b"]",
          b": ", b"- ", b"\n", b"1e309", b"-", b"'", b'"', b"PK\x05\x06", b"\x93NUMPY", b"<", b">", b"&lt;", b".inf", b"99999999999"]  # fmt: skip

TEXTS = ("", "x", "nan", "inf", "-inf", "1e308", "-1e308", "1e9", "1e12", "1e-320", "0", "-1", "1", "4", "99999999", "1e99999", "0x10", "٣")  # fmt: skip


def nest(depth: int, value: Any = 0) -> Any:
    """A list in a list in a list."""
    for _ in range(depth):
        value = [value]
    return value


def spots(value: Any, path: tuple[Any, ...] = ()) -> list[tuple[Any, ...]]:
    """Paths to everything in a document."""
    found = [path]
    if isinstance(value, dict):
        for key, item in value.items():
            found += spots(item, (*path, key))
    elif isinstance(value, list):
        for i, item in enumerate(value):
            found += spots(item, (*path, i))
    return found


def document(rng: random.Random, seed: Any) -> Any:
    """A document with a few places spoilt."""
    d = copy.deepcopy(seed)
    for _ in range(rng.choice((1, 1, 1, 2, 3, 6))):
        paths = [p for p in spots(d) if p]
        if not paths or len(paths) > 5000:  # repeats of repeats grow fast
            break
        path = rng.choice(paths)
        parent = d
        for step in path[:-1]:
            parent = parent[step]
        _spoil(rng, parent, path[-1])
    return d


def _spoil(rng: random.Random, parent: Any, key: Any) -> None:
    old = parent[key]
    what = rng.randrange(9)
    if rng.random() < 0.5 and isinstance(old, int | float) and not isinstance(old, bool):
        # near enough to be read: what is accepted must be right
        parent[key] = rng.choice((0.0, -old, old * rng.uniform(0.0, 3.0), old + rng.gauss(0.0, 1.0), 1e-7, 1e4, 1e8))
        return
    if what == 0:
        del parent[key]
    elif what == 1 and isinstance(parent, list):
        parent.insert(key, copy.deepcopy(old))
    elif what == 2 and isinstance(old, int | float) and not isinstance(old, bool):
        parent[key] = _scaled(rng, old)
    elif what == 3 and isinstance(old, list):
        parent[key] = old * rng.choice((0, 2, 50)) if rng.random() < 0.7 else old[::-1]
    elif what == 4 and isinstance(old, str):
        parent[key] = rng.choice([*RULES, "cos(x) * sin(y)", "dubins_3d", "per_step", "exact", "sos", "monte-carlo"])
    elif what == 5 and isinstance(parent, dict):
        parent[rng.choice(("x", "n", "order", "samples", "steps", "name", "times", "a" * 300, "\u2028"))] = rng.choice(
            NASTY
        )
    elif what == 6:
        parent[key] = nest(rng.choice((1, 2, 20, 60)), old)
    else:
        parent[key] = copy.deepcopy(rng.choice(NASTY))


def _scaled(rng: random.Random, old: float) -> Any:
    factor = rng.choice((-1, 0, 1 + 1e-9, 1e3, 1e-3, 1e9, 1e18, 1e150, -1e150, 1e300))
    try:
        return old * factor
    except OverflowError:
        return float("inf")


def raw(rng: random.Random, content: bytes) -> bytes:
    """Bytes flipped, cut, repeated, put in."""
    data = bytearray(content)
    for _ in range(rng.choice((1, 1, 2, 4, 16))):
        if not data:
            data += rng.choice(TOKENS)
        i = rng.randrange(len(data))
        j = min(len(data), i + rng.choice((1, 1, 4, 30, 300)))
        what = rng.randrange(6)
        if what == 0:
            data[i] ^= 1 << rng.randrange(8)
        elif what == 1:
            del data[i:j]
        elif what == 2:
            data[i:i] = data[i:j] * rng.choice((1, 2, 20))
        elif what == 3:
            data[i:i] = rng.choice(TOKENS)
        elif what == 4:
            data[i:j] = rng.choice(TOKENS)
        else:
            del data[i:]
    return bytes(data)


def arrays(rng: random.Random, seed: dict[str, Any]) -> bytes:
    """An .npz with arrays spoilt, and now and then the archive itself."""
    d = dict(seed)
    for _ in range(rng.choice((1, 1, 2, 3))):
        key = rng.choice(list(d)) if d else "times"
        d[key] = _array(rng, d.get(key, np.zeros(1)))
        if rng.random() < 0.05:
            del d[key]
        if rng.random() < 0.1:
            d[rng.choice(("x", "type", "name", "factors", "headings", "length", "document"))] = _array(rng, np.ones(3))
    return archive(rng, d)


def archive(rng: random.Random, d: dict[str, Any]) -> bytes:
    """The archive: compressed or not, headers that lie, members that are no arrays."""
    out = io.BytesIO()
    how = rng.random()
    with zipfile.ZipFile(out, "w", rng.choice((zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED, zipfile.ZIP_BZIP2))) as z:
        for key, value in d.items():
            member = io.BytesIO()
            np.lib.format.write_array(member, np.asarray(value), allow_pickle=False)
            content = member.getvalue()
            if how < 0.1:
                content = _lied(rng, content)
            elif how < 0.15:
                content = raw(rng, content)
            z.writestr(f"{key}.npy", content)
    return raw(rng, out.getvalue()) if how > 0.9 else out.getvalue()


def _lied(rng: random.Random, content: bytes) -> bytes:
    """A header of a shape or type that the data is not."""
    shape = rng.choice(
        ("(10**9,)", "(1000000000, 1000)", "(0,)", "(-1,)", "(1" + "0" * 30 + ",)", "(3, 100000000)", "()")
    )
    descr = rng.choice(("<f8", "|O", "<U9", "<c16", "|S100000000", "<f2", ">f8", "V8", "<M8[s]"))
    header = f"{{'descr': '{descr}', 'fortran_order': False, 'shape': {shape}, }}\n".encode()
    return b"\x93NUMPY\x01\x00" + len(header).to_bytes(2, "little") + header + content[128:]


def _array(rng: random.Random, old: Any) -> Any:
    old = np.asarray(old)
    what = rng.randrange(8)
    if rng.random() < 0.4 and old.dtype.kind == "f":
        if rng.random() < 0.4:
            return np.asarray(rng.gauss(0.0, rng.choice((1e-9, 1.0, 1e6))) + old)
        return np.asarray(old * np.exp(rng.gauss(0.0, rng.choice((1e-9, 0.1, 3.0)))))
    if what == 0:
        dtypes = ("f4", "f2", "i8", "u1", "c16", "U10", "S5", "?", "M8[s]", ">f8")
        try:
            with np.errstate(all="ignore"):
                return old.astype(rng.choice(dtypes))
        except (ValueError, TypeError):
            return np.zeros(3)
    if what == 1:
        return old[None] if rng.random() < 0.5 else old.reshape(-1)
    if what == 2:
        return old[:0] if old.ndim else np.zeros((0, 3))
    if what == 3:
        return np.repeat(old, rng.choice((2, 100)), axis=0) if old.ndim else np.repeat(old, 3)
    if what == 4 and old.dtype.kind == "f" and old.size:
        new = old.copy().reshape(-1)
        new[rng.randrange(new.size)] = rng.choice((np.nan, np.inf, -1.0, 0.0, 1e9, 1e155, 1e308, -1e308, 1e-320))
        return new.reshape(old.shape)
    if what == 5 and old.dtype.kind == "f":
        with np.errstate(all="ignore"):
            return old * rng.choice((-1.0, 0.0, 1e9, 1e-9, 1e155, 1e-160))
    if what == 6 and old.dtype.kind == "U":
        text = str(old.reshape(-1)[0]) if old.size else ""
        try:
            return np.asarray(json.dumps(document(rng, json.loads(text))))
        except (ValueError, TypeError):
            return np.asarray(rng.choice(("gaussian", "moments", "controls", "", "x" * 2000)))
    return np.asarray(rng.choice((0.0, -1.0, "x", np.nan, 1e308, True, 3)))


def xml(rng: random.Random, seed: bytes) -> bytes:
    """Elements dropped, doubled, moved, texts and attributes replaced; or bytes."""
    if rng.random() < 0.2:
        return raw(rng, seed)
    root = ElementTree.fromstring(seed)  # noqa: S314  our own
    for _ in range(rng.choice((1, 1, 1, 2, 4))):
        everything = list(root.iter())
        node = rng.choice(everything)
        what = rng.randrange(6)
        if what == 0 and len(node):
            node.remove(rng.choice(list(node)))
        elif what == 1 and len(node):
            child = rng.choice(list(node))
            for _ in range(rng.choice((1, 1, 30))):
                node.append(copy.deepcopy(child))
        elif what == 2 and node.attrib:
            node.attrib[rng.choice(list(node.attrib))] = _text(rng)
        elif what == 3:
            other = rng.choice(everything)
            if node not in list(other.iter()):
                node.append(copy.deepcopy(other))
        elif what == 4:
            node.tag = rng.choice(everything).tag
        else:
            leaves = [n for n in everything if not len(n)]
            rng.choice(leaves).text = _text(rng)
    return ElementTree.tostring(root)


def _text(rng: random.Random) -> str:
    return rng.choice(TEXTS)


def command(rng: random.Random, seed: list[str]) -> list[str]:
    """Arguments dropped, doubled, swapped, replaced."""
    words = list(seed)
    values = ("", "-", "--", "-1", "0", "1e308", "nan", "inf", "none", "x", "é", "exact", "sos,", ",,", "\udcff", "9" * 30, "--json", "--help", "-h",
              "--version", "--seed", "--bound", "--problem", "--checker=exact", "@x", "{scene}", "{plan}", "{out}", "/", "/dev/null", "a\x00b", "a\nb",
              "plan", "assess", "render", "demo2", "1.5", "2147483648", "1_0")  # fmt: skip
    for _ in range(rng.choice((1, 1, 2, 3))):
        what, i = rng.randrange(4), rng.randrange(len(words)) if words else 0
        if what == 0 and words:
            del words[i]
        elif what == 1 and words:
            words[i] = rng.choice(values)
        elif what == 2:
            words.insert(i, rng.choice(values))
        elif words:
            j = rng.randrange(len(words))
            words[i], words[j] = words[j], words[i]
    return words


Maker = Callable[[random.Random], Any]
