"""``wkernels bench``: the JSON contract, what is said of a missing peer, and that both sides draw the same images."""

from __future__ import annotations

import builtins
import json
import sys
from typing import Any

import numpy as np
import pytest

from experiments import cli
from experiments.bench import cases, rows
from experiments.bench.cases import CASES, Bench, Sizes
from experiments.bench.llvmpipe import Llvmpipe, PeerMissing, clip_matrix
from experiments.bench.meshes import Mix, camera, spheres_on_terrain
from experiments.bench.rows import Row, interleaved_medians
from experiments.commands import bench as command
from wkernels.views import HostView, eye_view

SMALL = Mix(12, 1, 12, radii=(10.0, 40.0))
TINY = Sizes(map_side=64, image=(64, 48), frame=(32, 18), mixes=dict.fromkeys(("10k", "250k", "2500k", "soft"), SMALL))
FIELDS = {"name", "ours_ms", "peer", "peer_ms", "ratio", "mismatch", "note"}
PASSES = ("depth_10k", "depth_250k", "depth_2500k", "gbuffer_250k", "pcss_16_16")


@pytest.fixture
def peer() -> Any:
    """llvmpipe, where this machine has it."""
    try:
        opened = Llvmpipe(1)
    except PeerMissing as missing:
        pytest.skip(f"llvmpipe is missing: {missing}")
    yield opened
    opened.close()


@pytest.fixture
def no_moderngl(monkeypatch: pytest.MonkeyPatch) -> None:
    real = builtins.__import__

    def refuse(name: str, *arguments: Any, **options: Any) -> Any:
        if name == "moderngl":
            raise ImportError(name)
        return real(name, *arguments, **options)

    monkeypatch.setattr(builtins, "__import__", refuse)


def in_json(capsys: pytest.CaptureFixture[str], *only: str) -> dict[str, Any]:
    command.run_bench(only=only, as_json=True, threads=1, repeats=1, sizes=TINY)
    result: dict[str, Any] = json.loads(capsys.readouterr().out)
    return result


def test_json_has_every_pass_and_its_environment(capsys: pytest.CaptureFixture[str]) -> None:
    result = in_json(capsys, *PASSES, "threads_1_2")
    assert set(result) == {"environment", "results"}
    assert result["environment"]["threads"] == 1 and result["environment"]["cpu"]
    assert result["environment"]["peers"]["llvmpipe"]
    by_name = {row["name"]: row for row in result["results"]}
    assert list(by_name) == [*PASSES, "threads_1_2.rasteriser", "threads_1_2.pcss"]
    for row in by_name.values():
        assert set(row) == FIELDS and row["ours_ms"] > 0.0
        assert (row["ratio"] is None) == (row["peer_ms"] is None)
        if row["ratio"] is not None:
            assert row["ratio"] == pytest.approx(row["peer_ms"] / row["ours_ms"])
    assert by_name["threads_1_2.pcss"]["peer"] == "1 thread"


def test_frames_have_no_peer(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    known = cases.load_all()
    monkeypatch.setattr(cases, "load_all", lambda: {name: known[name] for name in ("shadow_map", "tc_soft_paper")})
    result = in_json(capsys, "frames")["results"]
    assert [row["name"] for row in result] == ["frames.shadow_map", "frames.tc_soft_paper"]
    assert all(row["ours_ms"] > 0.0 and row["peer"] is row["peer_ms"] is row["ratio"] is None for row in result)


def test_frames_that_cannot_run_say_why(monkeypatch: pytest.MonkeyPatch, tmp_path: Any) -> None:
    monkeypatch.setattr(cases, "OVERLAP", tmp_path / "overlap.yaml")
    (row,) = CASES["frames"](Bench(TINY, 1, 1, "none"), "frames")
    assert row.ours_ms is None and "overlap.yaml is missing" in row.note


@pytest.mark.usefixtures("no_moderngl")
def test_a_missing_peer_is_named(capsys: pytest.CaptureFixture[str]) -> None:
    result = in_json(capsys, "depth_10k", "pcss_16_16")
    assert result["environment"]["peers"]["llvmpipe"].startswith("missing: moderngl is not installed")
    for row in result["results"]:
        assert row["ours_ms"] > 0.0 and row["peer"] == "llvmpipe"
        assert row["peer_ms"] is row["ratio"] is row["mismatch"] is None
        assert "llvmpipe is missing: moderngl is not installed" in row["note"]


def test_another_renderer_is_not_taken_for_llvmpipe(monkeypatch: pytest.MonkeyPatch) -> None:
    moderngl = pytest.importorskip("moderngl")

    class Context:
        def __init__(self) -> None:
            self.info = {"GL_RENDERER": "Some GPU"}

        def release(self) -> None: ...

    asked: list[int] = []

    def create(device_index: int, **_: Any) -> Context:
        asked.append(device_index)
        if device_index == 2:
            raise RuntimeError("no such device")
        return Context()

    monkeypatch.setattr(moderngl, "create_context", create)
    with pytest.raises(PeerMissing, match="device 1 is Some GPU; no such device"):
        Llvmpipe(1)
    assert asked == [0, 1, 2]


@pytest.mark.peers
@pytest.mark.parametrize("name", PASSES)
def test_both_sides_draw_the_same_image(name: str, peer: Llvmpipe) -> None:
    (row,) = CASES[name](Bench(TINY, 1, 1, peer), name)
    assert row.mismatch is not None and row.mismatch <= 2e-3  # rounding at edges: a handful of 3072 or 4096 pixels


@pytest.mark.peers
def test_a_different_image_is_a_mismatch(peer: Llvmpipe, monkeypatch: pytest.MonkeyPatch) -> None:
    triangle_pass, pcss_pass = peer.triangle_pass, peer.pcss_pass

    def shifted(vertices: np.ndarray, *others: Any) -> Any:
        return triangle_pass(vertices + np.array([0.0, 10.0, 0.0]), *others)

    def without_casters(images: dict[str, np.ndarray], taps: Any, **values: Any) -> Any:
        return pcss_pass({**images, "map_depth": np.full_like(images["map_depth"], 1e6)}, taps, **values)

    monkeypatch.setattr(peer, "triangle_pass", shifted)
    monkeypatch.setattr(peer, "pcss_pass", without_casters)
    for name in ("depth_10k", "gbuffer_250k", "pcss_16_16"):
        (row,) = CASES[name](Bench(TINY, 1, 1, peer), name)
        assert row.mismatch is not None and row.mismatch > 0.02, name


def test_unknown_case_ends_with_status_2(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setattr(sys, "argv", ["wkernels", "bench", "--only", "depth_10"])
    with pytest.raises(SystemExit) as ended:
        cli.main()
    assert ended.value.code == 2
    captured = capsys.readouterr()
    assert captured.err == "error: --only: there is no case 'depth_10'. Did you mean 'depth_10k'?\n"
    assert not captured.out


def test_table_leaves_dashes_where_nothing_was_measured(capsys: pytest.CaptureFixture[str]) -> None:
    command.print_table([Row("a", 2.0, "p", 5.0, 1e-4, "x"), Row("b", None, note="gone")])
    head, first, second = capsys.readouterr().out.splitlines()
    assert head.split() == ["case", "ours", "ms", "peer", "ms", "ratio", "mismatch", "peer", "note"]
    assert first.split() == ["a", "2.00", "5.00", "2.50", "1.0e-04", "p", "x"]
    assert second.split() == ["b", "-", "-", "-", "-", "-", "gone"]


def test_sides_take_turns_and_warm_ups_do_not_count() -> None:
    turns: list[str] = []

    def side(name: str, times: list[float]) -> rows.Timed:
        waiting = iter([1e6] * rows.WARM_UPS + times)

        def run() -> float:
            turns.append(name)
            return next(waiting)

        return run

    assert interleaved_medians([side("a", [3.0, 1.0, 2.0]), side("b", [7.0, 9.0, 50.0])], 3) == [2.0, 9.0]
    assert "".join(turns[2 * rows.WARM_UPS :]) == "ababab"


def test_mesh_is_what_its_mix_says() -> None:
    vertices, faces = spheres_on_terrain(SMALL)
    assert len(faces) == 12 * 80 + 2 * 12**2 and faces.max() == len(vertices) - 1
    terrain = faces[12 * 80 :]
    a, b, c = (vertices[terrain[:, k]] for k in range(3))
    assert (np.cross(b - a, c - a)[:, 1] > 0.0).all()
    ball = vertices[faces[:80]]
    centre = ball.reshape(-1, 3).mean(axis=0)
    normals = np.cross(ball[:, 1] - ball[:, 0], ball[:, 2] - ball[:, 0])
    assert (np.einsum("ti,ti->t", normals, ball.mean(axis=1) - centre) > 0.0).all()


def test_clip_matrix_spans_the_depth_range() -> None:
    perspective = eye_view(camera(), 8, 6, np.zeros(3))
    axes = {"right_ws": np.eye(3)[0], "up_ws": np.eye(3)[1], "forward_ws": -np.eye(3)[2], "eye_ws": np.zeros(3)}
    orthographic = HostView(**axes, window=(-1, 1, -1, 1), near=2.0, far=7.0, width=8, height=6, perspective=False)
    for view in (perspective, orthographic):
        for depth, expected in ((view.near, -1.0), (view.far, 1.0)):
            x, y, z, w = clip_matrix(view) @ np.append(view.eye_ws + depth * view.forward_ws, 1.0)
            assert (x / w, y / w, z / w) == pytest.approx((0.0, 0.0, expected), abs=1e-9)
