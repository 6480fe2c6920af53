"""Symbolic links that lead out of a folder: nothing behind them is changed."""

import shutil

import pytest
from arena import Arena
from judgement import judge_end

pytestmark = pytest.mark.long
VERIFY, STATUS = "night-render verify data", "night-render status data"
CONVERT = "night-render convert data --only 000000 --out new --to itof"
DROP = "night-render drop-transients data --only 000000 --yes"
GEN = "night-gen scenes made_ply --preset ply.toml --count 2"
TRAIN = "night-train closed --out new --preset training.toml --device cpu"
RESUME = "night-train closed --out run --resume --max-epochs 2 --device cpu"
PREDICT = "night-eval predict run itof.exr --out pred --device cpu"
RENDER = "data/renders/000000"
LINKS = [
    *((RENDER, command) for command in (VERIFY, CONVERT, DROP)),
    *((f"{RENDER}/{name}", DROP) for name in ("render.json", "transient.exr", "itof.exr")),
    *((f"{RENDER}/{name}", VERIFY) for name in ("render.json", "itof.exr")),
    *((f"data/renders/{name}", VERIFY) for name in (".", ".claims", ".hashes.json")),
    *((f"data/renders/{name}", STATUS) for name in (".", ".claims/000001", ".hashes.json")),
    *((f"data/renders/{name}", DROP) for name in (".run", "rendering.json")),
    *((f"data/scenes/{name}", VERIFY) for name in (".", "000000", "000000/scene.json")),
    *((f"made_ply/{name}", GEN) for name in ("dataset.json", "scenes", "scenes/000000")),
    *((f"made_ply/scenes/000000/{name}", GEN) for name in ("scene.json", "relay_wall.ply")),
    *((f"closed/shards/{name}", TRAIN) for name in (".", "000000", "000000/mask.npy", "manifest.json")),
    ("closed/.hashes.json", TRAIN),
    *((f"run/{name}", RESUME) for name in ("log", "checkpoint.pt", "run.json", "best.safetensors")),
    *((f"pred/{name}", PREDICT) for name in ("000000.exr", "prediction.json")),
]


@pytest.fixture(scope="module")
def arena(samples, tmp_path_factory):
    return Arena(tmp_path_factory.mktemp("links") / "arena", samples)


@pytest.mark.parametrize(("path", "command"), LINKS)
def test_nothing_behind_a_link_that_leads_out_is_changed(forks, arena, path, command):
    inner, victim = (arena.work / path).resolve(), arena.folder / "victim"
    if inner.exists():
        inner.rename(victim / "linked")
    else:
        shutil.copy(victim / "keep.txt", victim / "linked")
    inner.parent.mkdir(exist_ok=True)
    inner.symlink_to(victim / "linked")
    before = arena.state("victim")
    end = forks.run(command.split(), arena.work)
    after = arena.state("victim")
    arena.restore(arena.changed(), set())
    assert judge_end(end) is None, end
    assert after == before, end
