"""What every case of the bench gets: how large it is, threads, repeats and the peer."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from experiments.bench.llvmpipe import NAME, Llvmpipe
from experiments.bench.meshes import Mix
from experiments.bench.rows import Row, Timed, interleaved_medians
from experiments.scenes import load_scene
from wkernels.scene.model import Scene

CONFIGS = Path(__file__).resolve().parents[2] / "configs"

SCENES = ("paris", "overlap", "bunny", "big_penumbra", "winter")


class SceneMissing(Exception):
    """A scene file is not there, as where configs/ is not beside the installed packages; the message names it."""


def _scene_files() -> dict[str, Path | Scene]:
    return {name: CONFIGS / "scenes" / f"{name}.yaml" for name in SCENES}


@dataclass(frozen=True)
class Sizes:
    """How large the cases are; the fields' defaults are what their names say.

    Attributes:
        map_side: Texels per side of maps.
        image: Width and height of camera images [pixels].
        frame: Width and height of whole frames [pixels].
        mixes: Meshes of the cases by name of their size.
        scenes: Scenes of the cases by name, or their files.
        samples: Points on the light of techniques that take more by default, in whole frames.
        walk_frames: Frames of the demo's walkthrough.
        reference: Width and height of references [pixels].
        reference_frame: Frame of paris' path: before the tower, where penumbrae are many. Other scenes begin theirs.
        reference_counts: Growing rays per pixel.
        embree_rays: About as many rays go through embreex, which gets one at a time; its time is scaled.
        triangle_mixes: Meshes of growing size by name.
        map_sides: Growing texels per side.
        images: Growing widths and heights [pixels].
        sample_counts: Growing points on the light.
        sampled_frame: Width and height of the frames with them [pixels].
        memory_frames: Frames over which memory may not grow.
        memory_frame: Their width and height [pixels].
    """

    map_side: int = 1024
    image: tuple[int, int] = (1024, 768)
    frame: tuple[int, int] = (640, 360)
    mixes: Mapping[str, Mix] = field(
        default_factory=lambda: {
            "10k": Mix(25, 2, 31),
            "250k": Mix(180, 3, 99),
            "2500k": Mix(450, 4, 299),
            "soft": Mix(120, 3, 99, radii=(10.0, 40.0)),
        }
    )
    scenes: Mapping[str, Path | Scene] = field(default_factory=_scene_files)
    samples: int = 16
    walk_frames: int = 25
    reference: tuple[int, int] = (512, 384)
    reference_frame: int = 125
    reference_counts: Sequence[int] = (16, 64, 256, 1024, 4096)
    embree_rays: int = 2_000_000
    triangle_mixes: Mapping[str, Mix] = field(
        default_factory=lambda: {
            "1e4": Mix(25, 2, 31),
            "1e5": Mix(72, 3, 63),
            "1e6": Mix(180, 4, 199),
            "1e7": Mix(450, 5, 630),
        }
    )
    map_sides: Sequence[int] = (256, 512, 1024, 2048, 4096)
    images: Sequence[tuple[int, int]] = ((256, 192), (512, 384), (1024, 768), (2048, 1536))
    sample_counts: Sequence[int] = (1, 4, 16, 64, 256, 1024)
    sampled_frame: tuple[int, int] = (256, 192)
    memory_frames: int = 1000
    memory_frame: tuple[int, int] = (64, 36)


@dataclass(frozen=True)
class Bench:
    """What every case gets.

    Attributes:
        sizes: How large the cases are.
        threads: CPU threads of both sides.
        repeats: Timed runs of each side.
        peer: The peer of triangle and pixel passes, or why there is none.
    """

    sizes: Sizes
    threads: int
    repeats: int
    peer: Llvmpipe | str

    def beside_peer(
        self,
        name: str,
        ours: Timed,
        make_peer: Callable[[Llvmpipe], Any],
        mismatch: Callable[[Any], float],
        note: str,
        *,
        draws: int = 1,
        most_s: float = float("inf"),
    ) -> Row:
        """A row with the peer's pass if there is a peer, else with the reason why there is none.

        Args:
            name: Of the row.
            ours: Our side.
            make_peer: Sets up the peer's pass.
            mismatch: Compares the images of the peer's pass and ours.
            note: What is timed.
            draws: How often the peer draws for one run of ours.
            most_s: See ``interleaved_medians``.
        """
        if isinstance(self.peer, str):
            (ours_ms,) = interleaved_medians([ours], self.repeats, most_s=most_s)
            return Row(name, ours_ms, NAME, note=f"{note}; {NAME} is missing: {self.peer}")
        other = make_peer(self.peer)
        sides = [ours, lambda: sum(other.draw() for _ in range(draws))]
        ours_ms, peer_ms = interleaved_medians(sides, self.repeats, most_s=most_s)
        return Row(name, ours_ms, NAME, peer_ms, mismatch(other), note)

    def scene(self, name: str) -> Scene:
        """A scene of ``Sizes.scenes``.

        Raises:
            SceneMissing: Its file is not there.
        """
        held = self.sizes.scenes[name]
        if isinstance(held, Scene):
            return held
        if not held.is_file():
            raise SceneMissing(f"{held.name} is missing: configs/ is not beside the installed packages")
        return load_scene(held)
