"""Formulas over the arrays of a file: they compute what numpy computes, and nothing else."""

import numpy as np
import pytest
from captures import IMAGES, raw_of, sidecar_of

from itof.capture.formulas import names_in, value_of
from itof.capture.sidecar import CaptureError

RNG = np.random.default_rng(0)
A, B = RNG.integers(0, 2**16, (5, 6, 8)).astype(np.uint16), RNG.random((6, 8))
ARRAYS = {"a": A, "data.b": B, "inner/raw": A, "z": B + 1j}
WIDE = A.astype(float)
FORMULAS = {
    "a": A,
    "inner/raw": A,
    "= a[0:2, :, :4]": A[0:2, :, :4],
    "= a[..., ::-2]": A[..., ::-2],
    "= a[-1][1, 2:]": A[-1][1, 2:],
    "= 2 * a - 1": 2 * WIDE - 1,
    "=a*a": WIDE * WIDE,
    "= (2 * a[0:2] - 1) * data.b / 1e3": (2 * WIDE[0:2] - 1) * B / 1e3,
    "= (a + 1024) % 2048 - 1024": (WIDE + 1024) % 2048 - 1024,
    "= a // 16 + -3.5": WIDE // 16 - 3.5,
    "= 'inner/raw'[0] + a[1]": WIDE[0] + WIDE[1],
    "= z * exp(-1j * pi * data.b)": (B + 1j) * np.exp(-1j * np.pi * B),
    "= sqrt(abs(sin(data.b))) + cos(data.b)": np.sqrt(np.abs(np.sin(B))) + np.cos(B),
    "= reshape(a, 5, 3, -1)[0]": A.reshape(5, 3, -1)[0],
}


@pytest.mark.parametrize("text", FORMULAS)
def test_a_formula_is_what_numpy_computes(text):
    found = value_of(text, ARRAYS)
    np.testing.assert_array_equal(found, FORMULAS[text])
    assert found.dtype == FORMULAS[text].dtype


def test_the_names_of_a_formula_are_those_of_its_arrays():
    assert names_in("= (2 * a[0:2] - 1) * data.b + a[2] + sin('x y') * pi") == ("a", "data.b", "a", "x y")


REFUSED = [
    "= __import__('os').system('true')",
    "= a.sum()",
    "= a ** 9999",
    "= a @ a",
    "= open(a)",
    "= [a, a]",
    "= a[a]",
    "= a[(0, 0),]",
    "= a[0.5]",
    "= a[None]",
    "= a[True]",
    "= a if a else a",
    "= lambda: a",
    "= (a := 1)",
    "= f'{a}'",
    "= exp(a, a)",
    "= exp(a, dtype=1)",
    "= reshape(a, a)",
    "= reshape(a)",
    "= a and a",
    "= True * a",
    "= 2 + 2",
    "= ",
    "= a +",
    "= " + "(" * 190,
    "= " + "+".join(["a"] * 1200),
    "= a; a",
    "= a\x00",
]


@pytest.mark.parametrize("text", REFUSED)
def test_a_formula_with_any_other_part_is_refused_before_a_file_is_read(tmp_path, text):
    with pytest.raises(ValueError, match=r"formula|names no array"):
        names_in(text)
    if text.isprintable():
        with pytest.raises(CaptureError, match=r"sidecar\.toml"):
            sidecar_of(tmp_path, IMAGES, layout="phasors", arrays=[text])


@pytest.mark.parametrize("name", [r"a\x00", r"a\n", r"\ud800"])
def test_a_formula_cannot_name_what_cannot_be_printed(name):
    with pytest.raises(ValueError, match="signs that cannot be printed"):
        names_in(f"= '{name}' + a")


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("= a[7]", r"does not fit a \(5, 6, 8\): index 7 is out of bounds"),
        ("= a + data.b[0]", ""),
        ("= a + data.b[:, :3]", "does not fit a .*, data.b"),
        ("= reshape(a, 7, 7)", "cannot reshape"),
        ("= a[::0]", "slice step cannot be zero"),
    ],
)
def test_a_formula_that_does_not_fit_its_arrays_is_told(text, words):
    if words:
        with pytest.raises(ValueError, match=words):
            value_of(text, ARRAYS)
    else:
        assert value_of(text, ARRAYS).shape == A.shape


def test_a_result_that_no_memory_can_hold_is_refused():
    arrays = {"a": np.zeros((10**6, 1)), "b": np.zeros((1, 10**7))}
    with pytest.raises(ValueError, match=r"a result of shape \(1000000, 10000000\) claims"):
        value_of("= a * b", arrays)


def test_pixels_that_are_not_numbers_are_dead_up_to_a_part(tmp_path):
    z = np.ones((18, 26, 3), complex)
    z[2, 3, 0], z[4, 5] = np.nan, np.inf
    sidecar = sidecar_of(tmp_path, IMAGES, layout="phasors")
    raw = raw_of(sidecar, raw=z)
    lost = np.zeros((18, 26), bool)
    lost[2, 3] = lost[4, 5] = True
    np.testing.assert_array_equal(raw.lost, lost)
    assert np.isfinite(raw.values).all()
    z[:, :2] = np.nan
    with pytest.raises(CaptureError, match=r"holds 112 values that are NaN or infinite \(8 %\)"):
        raw_of(sidecar, raw=z)
    assert raw_of(sidecar_of(tmp_path, IMAGES, layout="phasors", most_nan=0.1), raw=z).lost[:, :2].all()
    windowed = sidecar_of(tmp_path, IMAGES, layout="phasors", window=[2, 0, 24, 18])
    assert raw_of(windowed, raw=z).lost.sum() == 2
