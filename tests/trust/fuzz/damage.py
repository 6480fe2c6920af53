"""Ways to damage a file: functions of a generator, its bytes, and those of another valid file of its kind.

Here: any bytes, and any text. `damage_formats` knows the structure of single formats.
"""

import json
import re

OUTSIDE = "../../victim"  # a folder beside that of the dataset: no command may touch it
NUMBERS = (0, -1, 1, 2, 255, 256, 2**15, 2**31 - 1, 2**31, 2**32, 2**53, 2**63 - 1, 2**63, 2**64, -(2**63))
WORDS = ("nan", "inf", "-inf", "NaN", "Infinity", "1e308", "1e400", "-0.0", "1e-320", "0x10", "true", "null")
TEXTS = (
    *(
        "",
        " ",
        ".",
        "..",
        "/",
        OUTSIDE,
        f"{OUTSIDE}/000000",
        f"{OUTSIDE}/keep.txt",
        "/proc/self/mem",
        "/dev/zero",
    ),
    *("\x00", "\x1b[2J", "\n", "ä\u202e☃", "\ud800", "A" * 70_000, "%n%s", "<script>", "'; --", "--help"),
)
ENCLOSING = ((b"[", b"]"), (b"{", b"}"), (b'{"a":', b"}"), (b"(", b")"), (b"<a>", b"</a>"))


def flip_a_bit(rng, data, other):
    place = _place(rng, data)
    return data[:place] + bytes([data[place] ^ 1 << int(rng.integers(8))]) + data[place + 1 :]


def replace_bytes(rng, data, other):
    place, count = _place(rng, data), int(rng.integers(1, 9))
    new = rng.bytes(count) if rng.random() < 0.5 else choice(rng, (b"\x00", b"\xff", b"\x80", b"\n")) * count
    return data[:place] + new + data[place + count :]


def write_a_number(rng, data, other):
    """An integer of 4 or 8 bytes over what was there: sizes, counts and offsets of binary headers."""
    place, size = _place(rng, data), choice(rng, (4, 8))
    number = choice(rng, NUMBERS) % 2 ** (8 * size)
    return data[:place] + number.to_bytes(size, choice(rng, ("little", "big"))) + data[place + size :]


def truncate(rng, data, other):
    return data[: _place(rng, data)]


def splice(rng, data, other):
    return data[: _place(rng, data)] + other[_place(rng, other) :]


def duplicate(rng, data, other):
    first, last = sorted((_place(rng, data), _place(rng, data)))
    return data[:last] + data[first:]


def leave_out(rng, data, other):
    first, last = sorted((_place(rng, data), _place(rng, data)))
    return data[:first] + data[last:]


def append(rng, data, other):
    return data + (other if rng.random() < 0.5 else rng.bytes(int(rng.integers(1, 5000))))


def replace_a_token(rng, data, other):
    """A number, a word or a quoted string of a text, replaced by an extreme or hostile one."""
    tokens = list(re.finditer(rb'"[^"\n]*"|[-+]?\d[\w.+-]*|[A-Za-z_]\w*', data))
    if not tokens:
        return flip_a_bit(rng, data, other)
    token = tokens[int(rng.integers(len(tokens)))]
    number = str(choice(rng, (*NUMBERS, *WORDS))).encode()
    text = json.dumps(choice(rng, TEXTS), ensure_ascii=bool(rng.random() < 0.5))
    quoted = text.encode("utf-8", "surrogatepass")
    if token[0].startswith(b'"'):
        new = quoted if rng.random() < 0.8 else number
    else:
        new = choice(rng, (number, number, number, quoted, quoted[1:-1]))
    return data[: token.start()] + new + data[token.end() :]


def replace_everywhere(rng, data, other):
    """A quoted string of a text, like a scene's id, replaced by a hostile one wherever it stands."""
    strings = sorted(set(re.findall(rb'"[^"\n]*"', data)))
    if not strings:
        return replace_a_token(rng, data, other)
    return data.replace(choice(rng, strings), json.dumps(choice(rng, TEXTS)).encode())


def change_lines(rng, data, other):
    """Lines removed, repeated, exchanged, or taken from another file."""
    lines = data.splitlines(keepends=True)
    first, second = (int(rng.integers(len(lines))) for _ in range(2))
    how = rng.integers(4)
    if how == 0:
        del lines[first]
    elif how == 1:
        lines.insert(second, lines[first])
    elif how == 2:
        lines[first], lines[second] = lines[second], lines[first]
    else:
        lines[first] = choice(rng, other.splitlines(keepends=True))
    return b"".join(lines)


def nest(rng, data, other):
    """Brackets within brackets, in the middle of a text."""
    depth = choice(rng, (50, 1500, 100_000))
    left, right = choice(rng, ENCLOSING)
    place = _place(rng, data)
    return data[:place] + left * depth + (right * depth if rng.random() < 0.7 else b"") + data[place:]


def other_encoding(rng, data, other):
    wide = data.decode(errors="replace").encode("utf-16")
    return choice(rng, (b"\xff\xfe" + data, data + b"\xc3\x28", wide, b"\xef\xbb\xbf" + data))


def choice(rng, values):
    """One of some values of any types, which `rng.choice` would convert."""
    return values[int(rng.integers(len(values)))]


ANY_BYTES = (flip_a_bit, replace_bytes, write_a_number, truncate, splice, duplicate, leave_out, append)
ANY_TEXT = (*[replace_a_token] * 4, *[replace_everywhere] * 2, *[change_lines] * 2)
ANY_TEXT += (nest, other_encoding, flip_a_bit, truncate, splice)
BYTES_OR_TEXT = (*ANY_BYTES, *ANY_TEXT)


def _place(rng, data):
    """A place in the bytes: near the beginning, near the end (where zip has its list), or anywhere."""
    near = min(len(data), 1024)
    start, stop = choice(rng, ((0, near), (len(data) - near, len(data)), (0, len(data))))
    return int(rng.integers(start, stop)) if stop > start else 0
