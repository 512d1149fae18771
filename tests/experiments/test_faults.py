"""What a run survives: a full disk, a folder that vanishes, techniques that return nonsense or end the process."""

from __future__ import annotations

import errno
import os
import shutil
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from fake_engine import FakeEngine, make_experiment, make_run

from experiments.kinds.walkthrough.run import run
from experiments.results import images
from experiments.results.failures import TechniquesFailed
from experiments.results.images import read_exr, write_exr, write_jpeg, write_png
from experiments.results.store import Store
from experiments.results.tables import Table, read_table, write_text
from wkernels.errors import InputError


class Disk:
    """A disk that takes nothing more below a folder while it is full; of a row it takes the first bytes."""

    def __init__(self, patch: pytest.MonkeyPatch, folder: Path) -> None:
        self.folder, self.full, self.refused = folder, False, 0
        self.write, self.reserve, self.write_bytes = os.write, os.posix_fallocate, Path.write_bytes
        patch.setattr(os, "write", self._write)
        patch.setattr(os, "posix_fallocate", self._reserve)
        patch.setattr(Path, "write_bytes", lambda path, data: self._write_bytes(path, data))

    def _check(self, path: str | Path) -> None:
        if self.full and Path(path).is_relative_to(self.folder):
            self.refused += 1
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    def _write(self, handle: int, data: bytes) -> int:
        if self.full and os.readlink(f"/proc/self/fd/{handle}").startswith(str(self.folder)):
            if len(data) > 5:
                return self.write(handle, data[:5])
            self._check(self.folder)
        return self.write(handle, data)

    def _reserve(self, handle: int, begin: int, size: int) -> None:
        self._check(os.readlink(f"/proc/self/fd/{handle}"))
        self.reserve(handle, begin, size)

    def _write_bytes(self, path: Path, data: bytes) -> int:
        self._check(path)
        return self.write_bytes(path, data)


@pytest.fixture
def disk(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Iterator[Disk]:
    if not Path("/proc/self/fd").is_dir() or not hasattr(os, "posix_fallocate"):
        pytest.skip("needs /proc and posix_fallocate")
    monkeypatch.setenv("TMPDIR", str(tmp_path / "spare"))
    monkeypatch.setattr("tempfile.tempdir", None)
    (tmp_path / "spare").mkdir()
    yield Disk(monkeypatch, tmp_path / "out")


class At:
    """Does something when the engine renders for the n-th time."""

    def __init__(self, **what: Callable[[], Any]) -> None:
        self.what, self.count = {int(name[1:]): do for name, do in what.items()}, 0

    def __call__(self, frame: int) -> None:
        self.count += 1
        if self.count in self.what:
            self.what[self.count]()


def experiment(**options: Any):
    runs = (make_run("a"), make_run("b", "remembering", own_error=True))
    return make_experiment(runs, **{"frames": range(4), "every": 2, "repeats": 2, **options})  # 3 + 16 renderings


def finished(out: Path, on_render: Callable[[int], None] = lambda frame: None, **options: Any) -> Store:
    e = experiment()
    return Store(run(e, out, engine=FakeEngine(e, on_render), report=False, **options))


def contents(out: Path) -> dict[str, bytes]:
    """Everything that two runs must share."""
    files = [p for p in out.rglob("*") if p.is_file() and p.suffix in (".csv", ".png", ".yaml")]
    return {p.relative_to(out).as_posix(): p.read_bytes() for p in files}


def same(parts: Path, whole: Path) -> bool:
    exr = [p.relative_to(whole) for p in whole.rglob("*.exr")]
    assert len(exr) == len(list(parts.rglob("*.exr"))) > 8
    for name in exr:
        np.testing.assert_array_equal(read_exr(parts / name), read_exr(whole / name))
    return contents(parts) == contents(whole)


# ---- The disk ----


def test_a_table_on_a_full_disk_keeps_whole_rows_and_catches_up(disk: Disk, tmp_path: Path) -> None:
    (tmp_path / "out").mkdir()
    table = Table(tmp_path / "out" / "t.csv", ("a", "b"))
    table.append([{"a": 1, "b": "one"}])
    before = table.path.read_bytes()
    disk.full = True
    for number in (2, 3):
        with pytest.raises(OSError, match="No space left"):
            table.append([{"a": number, "b": "a longer text"}])
        assert table.path.read_bytes() == before  # nothing torn
    assert table.text().count("\n") == 4
    disk.full = False
    table.append([{"a": 4}])
    table.close()
    assert [row["a"] for row in read_table(table.path)] == ["1", "2", "3", "4"]


def test_a_table_that_is_deleted_or_moved_is_made_anew(tmp_path: Path) -> None:
    table = Table(tmp_path / "x" / "t.csv", ("a",))
    table.path.parent.mkdir()
    table.append([{"a": 1}])
    shutil.rmtree(table.path.parent)
    table.append([{"a": 2}])
    table.path.rename(tmp_path / "moved.csv")
    table.append([{"a": 3}])
    table.close()
    assert table.path.read_text() == "a\n1\n2\n3\n"


def test_a_text_that_cannot_be_replaced_stays_as_it_was(disk: Disk, tmp_path: Path) -> None:
    (tmp_path / "out").mkdir()
    write_text(tmp_path / "out" / "t", "old")
    disk.full = True
    with pytest.raises(OSError, match="No space left"):
        write_text(tmp_path / "out" / "t", "new")
    assert [(p.name, p.read_text()) for p in (tmp_path / "out").iterdir()] == [("t", "old")]


@pytest.mark.parametrize("suffix", ["exr", "png", "jpg"])
def test_an_image_that_does_not_fit_is_an_error_and_leaves_nothing(disk: Disk, tmp_path: Path, suffix: str) -> None:
    """libjpeg ends the process on a full disk, and OpenImageIO says of a PNG that it is written."""
    write = {"exr": write_exr, "png": write_png, "jpg": write_jpeg}[suffix]
    picture = np.zeros((8, 8, 3), np.uint8) if suffix != "exr" else np.zeros((8, 8))
    disk.full = True
    path = tmp_path / "out" / f"x.{suffix}"
    with pytest.raises(OSError, match=f"No space left on device: '{path}'"):
        write(path, picture)
    assert list(path.parent.iterdir()) == []
    disk.full = False
    write(path, picture)
    assert path.is_file()


def test_an_image_that_cannot_be_completed_is_an_error(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The room that was reserved may be gone; a file that takes nothing stands for it."""
    monkeypatch.setattr(images, "_reserve", lambda part, size: part.symlink_to("/dev/full"))
    if not Path("/dev/full").exists():
        pytest.skip("needs /dev/full")
    with pytest.raises(OSError, match=str(tmp_path / "x.png")):
        write_png(tmp_path / "x.png", np.random.default_rng(1).integers(0, 255, (99, 99, 3)).astype(np.uint8))
    assert list(tmp_path.iterdir()) == []


def test_a_disk_that_is_full_for_a_while_costs_only_images_and_resume_makes_them(disk: Disk, tmp_path: Path) -> None:
    finished(tmp_path / "whole")
    fill, free = (lambda: setattr(disk, "full", True)), (lambda: setattr(disk, "full", False))
    with pytest.raises(
        TechniquesFailed, match=r"could not be stored on frame \d: OSError: cannot write .*exr: No space"
    ):
        finished(tmp_path / "out", At(_9=fill, _17=free))  # while frames 1 and 2 are rendered
    assert disk.refused > 6
    store = Store(tmp_path / "out")
    assert store.rows("frames") == Store(tmp_path / "whole").rows("frames")
    rows = store.rows("failures")
    assert {(row["label"], row["frame"], row["what"]) for row in rows} == {
        (name, "2", "file") for name in ("", "a", "b")
    }
    assert all(str(tmp_path / "out" / "images") in row["error"] and "more)" in row["error"] for row in rows)
    finished(tmp_path / "out", resume=True)
    shutil.rmtree(tmp_path / "out" / "failures")
    assert same(tmp_path / "out", tmp_path / "whole")


def test_rows_that_the_disk_never_takes_go_to_a_spare_folder(disk: Disk, tmp_path: Path) -> None:
    finished(tmp_path / "whole")
    with pytest.raises(TechniquesFailed, match=r"Tables could not be written .*frames\.csv \(No space left") as caught:
        finished(tmp_path / "out", At(_9=lambda: setattr(disk, "full", True)))
    spare = caught.value.spare
    assert spare is not None and str(spare) in str(caught.value) and spare.parent == tmp_path / "spare"
    for name in ("frames", "passes", "left_out"):
        assert (spare / f"{name}.csv").read_bytes() == (tmp_path / "whole" / f"{name}.csv").read_bytes()
    torn = (tmp_path / "out" / "frames.csv").read_bytes()
    assert torn == (tmp_path / "whole" / "frames.csv").read_bytes()[: len(torn)] and torn.endswith(b"\n")
    disk.full = False
    for path in spare.iterdir():
        shutil.copy(path, tmp_path / "out")
    finished(tmp_path / "out", resume=True)  # renders again only what lost its images
    assert same(tmp_path / "out", tmp_path / "whole")


def test_an_interrupted_run_says_where_its_rows_are(disk: Disk, tmp_path: Path) -> None:
    def interrupt() -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt) as caught:
        finished(tmp_path / "out", At(_9=lambda: setattr(disk, "full", True), _17=interrupt))
    assert "Tables could not be written" in caught.value.__notes__[0] and "they are in" in caught.value.__notes__[0]


def test_a_disk_that_is_full_at_the_beginning_is_one_message(disk: Disk, tmp_path: Path) -> None:
    disk.full = True
    with pytest.raises(InputError, match=r"out: cannot write results here \(No space left on device"):
        finished(tmp_path / "out")
    disk.full = False
    e = experiment()
    store = Store.open(tmp_path / "out", e.to_yaml(), {"identity": {}}, resume=False)
    disk.full = True
    with pytest.raises(InputError, match=r"No space left on device"), store.writing():
        pass
    assert list((tmp_path / "spare").iterdir()) == []  # nothing was computed


@pytest.mark.parametrize("when", [5, 13])
def test_a_folder_that_vanishes_is_made_again(tmp_path: Path, when: int) -> None:
    finished(tmp_path / "whole")
    with pytest.raises(TechniquesFailed, match=r"the folder failed on frame \d: .*the result folder was deleted"):
        finished(tmp_path / "out", At(**{f"_{when}": lambda: shutil.rmtree(tmp_path / "out")}))
    for name in ("frames", "passes", "left_out"):
        assert Store(tmp_path / "out").rows(name) == Store(tmp_path / "whole").rows(name)
    assert Store(tmp_path / "out").environment()["identity"]
    finished(tmp_path / "out", resume=True)
    shutil.rmtree(tmp_path / "out" / "failures")
    assert same(tmp_path / "out", tmp_path / "whole")


def test_a_folder_that_may_not_be_written_to(tmp_path: Path) -> None:
    """Everything may be written by root, who is nobody for a while."""
    root = os.geteuid() == 0
    (tmp_path / "out").mkdir(mode=0o555)
    if root:
        for folder in [tmp_path, *tmp_path.parents][:3]:
            folder.chmod(0o755)
        os.seteuid(65534)
    try:
        with pytest.raises(InputError, match=r"out: cannot write results here \(Permission denied"):
            Store.open(tmp_path / "out", "", {}, resume=False)
    finally:
        if root:
            os.seteuid(0)


def test_a_table_that_is_read_only_does_not_stop_a_resumed_run(tmp_path: Path) -> None:
    whole = finished(tmp_path / "out").rows("frames")
    lines = (tmp_path / "out" / "frames.csv").read_text().splitlines(keepends=True)
    (tmp_path / "out" / "frames.csv").write_text("".join(lines[:4]))
    (tmp_path / "out" / "frames.csv").chmod(0o444)
    assert finished(tmp_path / "out", resume=True).rows("frames") == whole


def test_a_folder_in_the_place_of_a_table_is_one_message(tmp_path: Path) -> None:
    finished(tmp_path / "out")
    (tmp_path / "out" / "passes.csv").unlink()
    (tmp_path / "out" / "passes.csv").mkdir()
    for resume in (True, False):
        with pytest.raises(InputError, match=r"cannot write results here \(Is a directory: passes\.csv\)"):
            finished(tmp_path / "out", resume=resume)


def test_two_runs_do_not_write_to_one_folder(tmp_path: Path) -> None:
    def second() -> None:
        for resume in (True, False):
            with pytest.raises(InputError, match="another run is writing here"):
                finished(tmp_path / "out", resume=resume)

    finished(tmp_path / "out", At(_9=second))
    finished(tmp_path / "out")


# ---- Techniques and what is around them ----


def test_a_technique_that_ends_the_process_has_failed(tmp_path: Path) -> None:
    def leave() -> None:
        sys.exit("enough")

    with pytest.raises(TechniquesFailed, match="'a' failed on frame 0: SystemExit: enough"):
        finished(tmp_path / "out", At(_4=leave))
    assert sum(row["label"] == "b" for row in Store(tmp_path / "out").rows("frames")) == 4


@pytest.mark.parametrize(
    ("spoil", "says"),
    [
        (lambda r: setattr(r, "not_finite", 7), "visibility is not finite in 7 of"),
        (lambda r: setattr(r, "visibility", r.visibility[:, 1:]), "visibility has the size (16, 23), not (16, 24)"),
        (lambda r: setattr(r, "standard_error", -r.visibility), "the standard error is negative or not finite"),
    ],
)
def test_a_result_that_cannot_be_measured_is_a_failure(tmp_path: Path, spoil: Callable[[Any], None], says: str) -> None:
    class Spoilt(FakeEngine):
        def open(self, lane):
            session, technique = super().open(lane)
            render = session.render

            def spoilt(own):
                result = render(own)
                if lane.label == "a" and session.frame == 2:
                    spoil(result)
                return result

            session.render = spoilt  # type: ignore[method-assign]
            return session, technique

    e = experiment()
    with pytest.raises(TechniquesFailed) as caught:
        run(e, tmp_path / "out", engine=Spoilt(e), report=False)
    assert f"'a' failed on frame 2: ValueError: {says}" in str(caught.value)
    rows = Store(tmp_path / "out").rows("frames")
    assert [row["label"] for row in rows].count("a") == 2 and [row["label"] for row in rows].count("b") == 4


def test_a_reference_that_cannot_be_made_is_a_failure_of_its_own(tmp_path: Path) -> None:
    finished(tmp_path / "whole")

    class NoReference(FakeEngine):
        def reference(self, frame):
            if frame == 2:
                raise MemoryError
            return super().reference(frame)

    e = experiment()
    with pytest.raises(TechniquesFailed, match="the reference failed on frame 2: MemoryError"):
        run(e, tmp_path / "out", engine=NoReference(e), report=False)
    store = Store(tmp_path / "out")
    assert len(store.rows("frames")) == 8 and {row["rmse"] for row in store.rows("frames") if row["frame"] == "2"} == {
        ""
    }
    finished(tmp_path / "out", resume=True)
    shutil.rmtree(tmp_path / "out" / "failures")
    assert same(tmp_path / "out", tmp_path / "whole")


def test_a_report_that_fails_loses_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(out: Path) -> None:
        raise ZeroDivisionError

    monkeypatch.setattr("experiments.kinds.walkthrough.report.write_report", fail)
    e = experiment()
    with pytest.raises(TechniquesFailed, match="the report failed: ZeroDivisionError"):
        run(e, tmp_path / "out", engine=FakeEngine(e))
    assert len(Store(tmp_path / "out").rows("frames")) == 8
    run(e, tmp_path / "out", engine=FakeEngine(e), resume=True, report=False)
    assert Store(tmp_path / "out").rows("failures") == []
