"""What a run of ``kind: convergence`` survives."""

from __future__ import annotations

import errno
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from test_convergence import TEXT, Engine, Load, load, run

from experiments.kinds.convergence import run as convergence
from experiments.kinds.convergence.store import ConvergenceStore
from experiments.results.failures import TechniquesFailed
from experiments.results.images import read_exr
from wkernels.errors import InputError

assert load  # the fixture


def same(parts: Path, whole: Path) -> None:
    assert (parts / "convergence.csv").read_bytes() == (whole / "convergence.csv").read_bytes()
    images = sorted(path.relative_to(whole) for path in whole.rglob("*.exr"))
    assert images == sorted(path.relative_to(parts) for path in parts.rglob("*.exr")) and len(images) > 6
    for name in images:
        np.testing.assert_array_equal(read_exr(parts / name), read_exr(whole / name))


@pytest.mark.parametrize(
    ("camera", "lost"),
    [("still", "memory/visibility_0003"), ("still", "reference/visibility_0001"), ("path", "sampled/error_0008")],
)
def test_an_image_that_cannot_be_written_is_made_by_resume(
    load: Load, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, camera: str, lost: str
) -> None:
    c = load(TEXT, f"camera={camera}", "techniques.0.fading.own_error=true")
    run(c, tmp_path / "whole")
    real = {"write_exr": convergence.write_exr, "write_png": convergence.write_png}

    def full(name: str) -> Any:
        def write(path: Path, *arguments: Any) -> None:
            if lost in path.as_posix():
                raise OSError(errno.ENOSPC, "No space left on device", str(path))
            real[name](path, *arguments)

        return write

    for name in real:
        monkeypatch.setattr(convergence, name, full(name))
    with pytest.raises(TechniquesFailed, match=rf"could not be stored on frame \d: OSError: cannot write .*{lost}"):
        run(c, tmp_path / "parts")
    store = ConvergenceStore(tmp_path / "parts")
    assert store.rows("convergence") == ConvergenceStore(tmp_path / "whole").rows("convergence")
    assert [row["what"] for row in store.rows("failures")] == ["file"]
    for name in real:
        monkeypatch.setattr(convergence, name, real[name])
    run(c, tmp_path / "parts", resume=True)
    same(tmp_path / "parts", tmp_path / "whole")


def test_a_folder_that_vanishes_is_made_again(load: Load, tmp_path: Path) -> None:
    c, count = load(), 0
    run(c, tmp_path / "whole")

    def vanish(frame: int) -> None:
        nonlocal count
        count += 1
        if count == 8:
            shutil.rmtree(tmp_path / "parts")

    with pytest.raises(TechniquesFailed, match="the result folder was deleted"):
        run(c, tmp_path / "parts", engine=Engine(c.experiment, vanish))
    parts = (tmp_path / "parts" / "convergence.csv").read_bytes()
    assert parts == (tmp_path / "whole" / "convergence.csv").read_bytes()
    run(c, tmp_path / "parts", resume=True)
    same(tmp_path / "parts", tmp_path / "whole")


def test_what_cannot_be_measured_is_a_failure(load: Load, tmp_path: Path) -> None:
    class Spoilt(Engine):
        def open(self, lane: Any) -> Any:
            session, technique = super().open(lane)
            render = session.render

            def spoilt(own: Any) -> Any:
                result = render(own)
                result.not_finite = 4 if lane.label == "memory" and session.frame == 2 else 0
                return result

            session.render = spoilt  # type: ignore[method-assign]
            return session, technique

    c = load()
    with pytest.raises(
        TechniquesFailed, match="'memory' failed on frame 3: ValueError: visibility is not finite in 4 of"
    ):
        run(c, tmp_path / "o", engine=Spoilt(c.experiment))
    rows = ConvergenceStore(tmp_path / "o").rows("convergence")
    assert [row["step"] for row in rows if row["label"] == "memory"] == ["1"]
    assert sum(row["label"] == "sampled" for row in rows) == 6


def test_input_that_is_refused_ends_the_run_at_once_and_later_fails(load: Load, tmp_path: Path) -> None:
    c = load()

    def refuse_from(count: int) -> Any:
        def refuse(frame: int) -> None:
            nonlocal count
            count -= 1
            if count == 0:
                raise InputError("that many do not fit.")

        return refuse

    with pytest.raises(InputError, match="do not fit"):
        run(c, tmp_path / "a", engine=Engine(c.experiment, refuse_from(1)))
    with pytest.raises(TechniquesFailed, match="InputError: that many do not fit"):
        run(c, tmp_path / "b", engine=Engine(c.experiment, refuse_from(6)))
    assert len(ConvergenceStore(tmp_path / "b").rows("convergence")) > 6


def test_a_reference_that_cannot_be_made_is_a_failure_of_its_own(load: Load, tmp_path: Path) -> None:
    class NoReference(Engine):
        def reference(self, frame: int) -> Any:
            if frame == 2:
                raise MemoryError
            return super().reference(frame)

    c = load(TEXT, "camera=path")
    run(c, tmp_path / "whole")
    with pytest.raises(TechniquesFailed, match="the reference failed on frame 3: MemoryError"):
        run(c, tmp_path / "parts", engine=NoReference(c.experiment))
    assert len(ConvergenceStore(tmp_path / "parts").rows("convergence")) == 12  # 5 steps each, but for the third
    run(c, tmp_path / "parts", resume=True)
    same(tmp_path / "parts", tmp_path / "whole")
