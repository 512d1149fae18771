"""The cached reference: what it is, when it is read back, and what a damaged cache does."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from experiments import reference_visibility, render_visibility
from experiments.rendering import reference
from experiments.rendering.reference import Reference, ReferenceRenderer, cache_folder
from wkernels.errors import InputError
from wkernels.scene.geometry import Geometry
from wkernels.scene.lights import DirectionalLight, DiscLight, Light, PointLight, RectangleLight
from wkernels.scene.model import Camera, Mesh, Scene

SIZE = {"width": 40, "height": 30}


def quad(half: float, y: float) -> tuple[np.ndarray, np.ndarray]:
    corners = [(-half, y, -half), (-half, y, half), (half, y, half), (half, y, -half)]
    return np.array(corners, dtype=np.float64), np.array([[0, 1, 2], [0, 2, 3]], dtype=np.int32)


def slide(frame: int) -> np.ndarray:
    pose = np.eye(4)
    pose[0, 3] = 0.5 * frame
    return pose


def scene(**light: object) -> Scene:
    vertices, faces = quad(1.0, 2.0)
    ground = Mesh("ground", *quad(10.0, 0.0))
    lid = Mesh("lid", vertices, faces, receives=False, object_to_ws=slide, moving=True)
    camera = Camera(np.array([0.0, 6.0, 6.0]), np.zeros(3), np.array([0.0, 1.0, 0.0]), 60.0, 0.1, 100.0)
    lamp = RectangleLight(
        center=np.array([0.0, 6.0, 0.0]), edge_u=np.array([1.0, 0.0, 0.0]), edge_v=np.array([0.0, 0.0, 1.0])
    )
    return Scene("lid", (ground, lid), (replace(lamp, **light),), lambda frame: camera, frames=4)


def render(of: Scene, *, samples: int = 16, frame: int = 0, **changed: object) -> Reference:
    settings: dict[str, object] = {**SIZE, **changed}
    return ReferenceRenderer(Geometry(of), samples=samples, **settings).render(frame)  # type: ignore[arg-type]


@pytest.fixture(autouse=True)
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("WKERNELS_CACHE", str(tmp_path))
    return tmp_path / "reference"


def same(a: Reference, b: Reference) -> bool:
    pairs = ((a.visibility, b.visibility), (a.standard_error, b.standard_error))
    return all(np.array_equal(x, y, equal_nan=True) for x, y in pairs)


def test_values() -> None:
    made = render(scene(), samples=64)
    assert made.visibility.shape == made.standard_error.shape == (30, 40)
    assert made.visibility.dtype == made.standard_error.dtype == np.float32
    seen = np.isfinite(made.visibility)
    assert np.array_equal(seen, np.isfinite(made.standard_error))
    v = made.visibility[seen].astype(np.float64)
    assert v.min() == 0.0 and v.max() == 1.0 and ((v > 0.0) & (v < 1.0)).any()
    np.testing.assert_allclose(made.standard_error[seen], np.sqrt(v * (1.0 - v) / 63.0), rtol=1e-5, atol=1e-7)


def test_the_centre_of_a_light_is_one_ray(cache: Path) -> None:
    """What ``ray_cast_point_shadow`` renders: hard, exact, and cached apart from the whole light's."""
    whole, centre = render(scene()), render(scene(), centre=True)
    assert not centre.from_cache and render(scene(), centre=True).from_cache and render(scene()).from_cache
    seen = np.isfinite(centre.visibility)
    assert set(np.unique(centre.visibility[seen])) == {0.0, 1.0} and (centre.standard_error[seen] == 0.0).all()
    assert not same(whole, centre)
    of = scene()
    hard = render_visibility(of, technique="ray_cast_point_shadow", **SIZE)  # type: ignore[arg-type]
    np.testing.assert_array_equal(centre.visibility, hard.visibility)
    point = replace(of, lights=(PointLight(position=np.array([0.0, 6.0, 0.0])),))
    assert same(render(point), render(point, centre=True))


def test_second_time_comes_from_the_cache(cache: Path) -> None:
    first, second = render(scene()), render(scene())
    assert not first.from_cache and second.from_cache
    assert same(first, second)
    assert [file.suffix for file in cache.iterdir()] == [".npz"]


def test_no_cache_reads_and_writes_nothing(cache: Path) -> None:
    assert not render(scene(), cache=False).from_cache
    assert not cache.exists()


def other_camera(of: Scene) -> Scene:
    return replace(of, camera=lambda frame: replace(of.camera(frame), fov_deg=50.0))


def other_vertex(of: Scene) -> Scene:
    vertices = of.meshes[1].vertices.copy()
    vertices[0, 0] -= 1e-3
    return replace(of, meshes=(of.meshes[0], replace(of.meshes[1], vertices=vertices)))


def not_casting(of: Scene) -> Scene:
    return replace(of, meshes=(of.meshes[0], replace(of.meshes[1], casts=False)))


def test_a_light_that_moves_has_a_reference_of_every_frame_and_shares_those_of_a_still_one(cache: Path) -> None:
    of = scene()
    of = replace(of, meshes=(of.meshes[0], replace(of.meshes[1], object_to_ws=lambda frame: np.eye(4), moving=False)))
    moving = replace(of, lights=(replace(of.lights[0], motion=lambda frame: slide(2 * (frame // 2))),))
    made = [render(moving, frame=frame) for frame in range(3)]
    assert [m.from_cache for m in made] == [False, True, False], "it rests in the second frame"
    assert not same(made[0], made[2])
    there = replace(of, lights=(moving.light(0, 2),))
    assert render(there).from_cache and same(render(there), made[2])
    assert render(of).from_cache and same(render(of), made[0])


@pytest.mark.parametrize(
    ("change", "settings"),
    [
        (None, {"samples": 17}),
        (None, {"frame": 1}),
        (None, {"width": 41}),
        (None, {"height": 31}),
        (None, {"seed": 2}),
        (other_camera, {}),
        (other_vertex, {}),
        (not_casting, {}),
        (lambda of: scene(edge_u=np.array([1.5, 0.0, 0.0])), {}),
        (lambda of: scene(texture=np.array([[1.0, 0.0]])), {}),
    ],
)
def test_whatever_changes_pixels_changes_the_key(
    change: Callable[[Scene], Scene] | None, settings: dict[str, int]
) -> None:
    render(scene())
    changed = scene() if change is None else change(scene())
    assert not render(changed, **settings).from_cache


@pytest.mark.parametrize("settings", [{"threads": 1}, {"threads": 2}])
def test_what_cannot_change_pixels_does_not(settings: dict[str, int]) -> None:
    first = render(scene())
    assert render(replace(scene(), name="another"), **settings).from_cache
    assert same(first, render(scene(), cache=False, **settings))


def test_frames_outside_this_one_do_not_matter() -> None:
    of = scene()
    render(of, frame=1)
    longer = replace(of, frames=9, camera=lambda frame: of.camera(0) if frame < 4 else other_camera(of).camera(0))
    assert render(longer, frame=1).from_cache


def test_code_change_changes_the_key(monkeypatch: pytest.MonkeyPatch) -> None:
    render(scene())
    monkeypatch.setattr(reference, "_source_digest", lambda files: "edited")
    assert not render(scene()).from_cache


def test_every_tracing_room_has_files() -> None:
    rooms = {path.parent.name for path in reference.tracing_files() if path.stem != "__init__"}
    assert set(reference.TRACING_ROOMS) == rooms


@pytest.mark.parametrize("damage", ["empty", "cut", "noise", "bit", "shape", "dtype", "key", "pickle"])
def test_damaged_file_is_made_again(cache: Path, damage: str) -> None:
    good = render(scene())
    (file,) = cache.iterdir()
    content = file.read_bytes()
    middle = len(content) // 3
    images = {"visibility": good.visibility, "standard_error": good.standard_error}
    match damage:
        case "empty":
            file.write_bytes(b"")
        case "cut":
            file.write_bytes(content[:middle])
        case "noise":
            file.write_bytes(b"no such format" * 20)
        case "bit":
            file.write_bytes(content[:middle] + bytes([content[middle] ^ 0xFF]) + content[middle + 1 :])
        case "shape":
            np.savez(file, **{name: image[1:] for name, image in images.items()})
        case "dtype":
            np.savez(file, **{name: image.astype(np.float64) for name, image in images.items()})
        case "key":
            np.savez(file, visibility=good.visibility)
        case "pickle":
            np.savez(file, visibility=np.array([{}], dtype=object), standard_error=good.standard_error)
    again = render(scene())
    assert not again.from_cache
    assert same(good, again)
    assert render(scene()).from_cache
    assert len(list(cache.iterdir())) == 1


def test_cache_that_cannot_be_written_is_no_error(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    blocked = tmp_path / "file"
    blocked.write_text("a file where a folder should be")
    monkeypatch.setenv("WKERNELS_CACHE", str(blocked))
    assert not render(scene()).from_cache
    assert not render(scene()).from_cache


def test_failed_write_leaves_nothing(cache: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_args: object, **_arrays: object) -> None:
        raise OSError("no space left on device")

    monkeypatch.setattr(reference.np, "savez_compressed", full)
    assert not render(scene()).from_cache
    assert list(cache.iterdir()) == []


@pytest.mark.parametrize(
    "light",
    [
        PointLight(position=np.array([0.0, 6.0, 0.0])),
        DirectionalLight(direction=np.array([0.0, -1.0, 0.0])),
        DiscLight(center=np.array([0.0, 6.0, 0.0]), normal=np.array([0.0, -1.0, 0.0]), radius=0.0),
    ],
)
def test_light_without_area_takes_one_exact_ray(light: Light) -> None:
    of = replace(scene(), lights=(light,))
    made = render(of, samples=64)
    seen = np.isfinite(made.visibility)
    assert set(np.unique(made.visibility[seen])) == {0.0, 1.0}
    assert np.all(made.standard_error[seen] == 0.0)
    assert np.isnan(made.standard_error[~seen]).all()
    assert render(of, samples=256).from_cache, "the number of samples does not matter here"


def test_renderer_equals_single_calls_on_a_moving_scene() -> None:
    renderer = ReferenceRenderer(Geometry(scene()), samples=16, cache=False, **SIZE)
    for frame in (0, 2, 1):
        assert same(renderer.render(frame), render(scene(), frame=frame, cache=False))
    moved = [renderer.render(frame).visibility for frame in (0, 3)]
    assert not np.array_equal(*moved, equal_nan=True)


@pytest.mark.parametrize("samples", [0, -1, 1_000_001, 2.5, True, "16"])
def test_wrong_sample_count(samples: object) -> None:
    with pytest.raises(InputError, match="samples: must be a whole number"):
        render(scene(), samples=samples)  # type: ignore[arg-type]


def test_default_folder(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("WKERNELS_CACHE")
    assert cache_folder().name == "reference"
    assert cache_folder().parent.name == "wkernels"


def test_python_call_uses_the_cache(cache: Path) -> None:
    v, se = reference_visibility(scene(), samples=16, frame=1, **SIZE)
    made = render(scene(), frame=1)
    assert made.from_cache
    assert np.array_equal(v, made.visibility, equal_nan=True)
    assert np.array_equal(se, made.standard_error, equal_nan=True)


@pytest.mark.parametrize("counts", [(16, 40), (1, 7), (16, 17, 100)])
def test_more_samples_go_on_where_fewer_ended(counts: tuple[int, ...], monkeypatch: pytest.MonkeyPatch) -> None:
    """To the bits of a reference that was made in one go, with only the missing samples traced."""
    traced: list[tuple[int, int]] = []
    trace = ReferenceRenderer._trace
    monkeypatch.setattr(
        ReferenceRenderer, "_trace", lambda self, *args: (traced.append(args[1:]), trace(self, *args))[1]
    )
    extended = [render(scene(), samples=samples) for samples in counts][-1]
    assert [sum(part) for part in traced] == list(counts)  # samples and start
    assert same(extended, render(scene(), samples=counts[-1], cache=False))
    assert render(scene(), samples=counts[-1]).from_cache


def test_an_interrupted_reference_goes_on_where_its_last_part_ended(
    cache: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """To the bits of one that was not; its parts leave one file in the end."""
    monkeypatch.setattr(reference, "PART", 16)
    whole = render(scene(), samples=40, cache=False)
    trace, traced = ReferenceRenderer._trace, []

    def once(self: ReferenceRenderer, frame: int, samples: int, start: int = 0) -> Reference:
        if len(traced) == 2:
            raise KeyboardInterrupt
        traced.append((samples, start))
        return trace(self, frame, samples, start)

    monkeypatch.setattr(ReferenceRenderer, "_trace", once)
    with pytest.raises(KeyboardInterrupt):
        render(scene(), samples=40)
    assert traced == [(16, 0), (16, 16)]
    monkeypatch.setattr(
        ReferenceRenderer, "_trace", lambda self, *args: (traced.append(args[1:]), trace(self, *args))[1]
    )
    assert same(render(scene(), samples=40), whole)
    assert traced[2:] == [(8, 32)] and render(scene(), samples=40).from_cache
    for file in cache.iterdir():
        file.unlink()
    assert same(render(scene(), samples=40), whole)
    assert len(list(cache.iterdir())) == 1


def test_weighted_samples_are_not_gone_on_with() -> None:
    """A textured light's sums are not whole numbers: another order of adding would give other bits."""
    textured = scene(texture=np.array([[0.0, 1.0], [3.0, 0.5]]))
    render(textured, samples=16)
    assert same(render(textured, samples=40), render(textured, samples=40, cache=False))
