"""For every check one technique that it must refuse: ``honest.py`` with a single fault."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np
import warp as wp
from honest import Honest
from pydantic import BaseModel, ConfigDict
from rig import CHECKS

from algorithms.technique import ExpectedFailure, Limit, Needs, Params, Technique, setting
from wkernels.frame.session import Session as Frame
from wkernels.workspace.products import Product

Spoil = Callable[[np.ndarray, Frame], np.ndarray]
BROKEN: list[tuple[str, type[Technique]]] = []


def broken(check: str, fault: str, spoil: Spoil | None = None, **attributes: Any) -> None:
    """Adds a technique for ``check`` whose finished visibility goes through ``spoil``, or whose declarations differ."""
    assert check in CHECKS, check

    def render(self: Technique, frame: Frame) -> wp.array:
        assert spoil is not None
        visibility = Honest.render(self, frame)
        spoiled = spoil(visibility.numpy().copy(), frame)
        return wp.array(spoiled.astype(np.float32), dtype=float, device=frame.device)

    body = dict(attributes) | {"__doc__": f"Broken: {fault}.", "__module__": Honest.__module__}
    if spoil is not None:
        body["render"] = render
    BROKEN.append((check, type("Honest", (Honest,), body)))


def position(frame: Frame) -> np.ndarray:
    return frame.gbuffer().position_ws.numpy()


def normal(frame: Frame) -> np.ndarray:
    return frame.gbuffer().normal_ws.numpy()


# ---- declarations ---------------------------------------------------------------------------------------------------


class Unbounded(Params):
    """A number without bounds."""

    samples: int = setting(64, "points on the light", unit="rays per pixel")


class NoUnit(Params):
    """A field that is not made with ``setting``."""

    samples: int = 64


class Lenient(BaseModel):
    """Takes whatever it is given."""

    model_config = ConfigDict(extra="allow")
    samples: int = setting(64, "points on the light", unit="rays per pixel", ge=1, le=1024)


class Ignored(Params):
    """A name that is never looked up."""

    samples: int = setting(64, "points on the light", unit="rays per pixel", ge=1, le=1024)
    shape: str = setting("round", "a choice", unit="name")


def failing(check: str, message: str, because: str = "by nature") -> tuple[ExpectedFailure]:
    """A declaration that a check fails."""
    return (ExpectedFailure(check=check, because=because, message=message),)


broken("file_name_and_class_agree", "named unlike its file", name="other")
broken("documentation_names_papers_and_artefacts", "says nothing", documentation=classmethod(lambda cls: "Shadows."))
broken("documentation_names_papers_and_artefacts", "a paper that the text does not name", paper=("crow1984",))
broken("papers_are_in_the_bibliography", "a paper that nobody wrote", paper=("heckbert1996",))
broken("papers_are_in_the_bibliography", "no paper", paper=())
broken("params_have_defaults_units_and_texts", "a parameter without a unit", Params=NoUnit)
broken("wrong_params_are_refused", "no bounds", Params=Unbounded)
broken("wrong_params_are_refused", "unknown names are accepted", Params=Lenient)
broken("wrong_params_are_refused", "a wrong choice is ignored", Params=Ignored)
broken("declarations_resolve", "equals nothing", limits=(Limit(equals="no_such_technique"),))
broken("declarations_resolve", "impossible parameters", limits=(Limit(equals="shadow_map", params={"samples": 0}),))
broken("declarations_resolve", "a limit as wide as a door", limits=(Limit(equals="shadow_map", flips=0.5),))
broken("declarations_resolve", "fails a check that does not exist", expected_failures=failing("no_such_check", "dark"))
broken("declarations_resolve", "fails without a reason", expected_failures=failing("image_is_visibility", "dark", " "))
broken("pulls_what_it_declares", "pulls light samples in silence", products=(Product.G_BUFFER, Product.RAY_STRUCTURE))
broken("pulls_what_it_declares", "declares a map that it never pulls", products=(*Honest.products, Product.LIGHT_MAP))
broken("declarations_resolve", "fails with any message", expected_failures=failing("image_is_visibility", ".*"))


# ---- images ---------------------------------------------------------------------------------------------------------


def write_to_gbuffer(v: np.ndarray, frame: Frame) -> np.ndarray:
    frame.gbuffer().depth.fill_(1.0)
    return v


def write_to_geometry(v: np.ndarray, frame: Frame) -> np.ndarray:
    frame.geometry.triangle_normal_ws.zero_()
    return v


def shift_one_pixel(v: np.ndarray, frame: Frame) -> np.ndarray:
    return np.roll(v, 2, axis=1)


def leak_and_darken(v: np.ndarray, frame: Frame) -> np.ndarray:
    return np.maximum(v**1.5, 0.005)


def nan_in_corner(v: np.ndarray, frame: Frame) -> np.ndarray:
    v[-1, -1] = np.nan
    return v


def shows_where(needless: Callable[[Frame], bool]) -> Spoil:
    """Leaves out a little light where a scene is thought not to need it."""
    return lambda v, frame: v * (1.0 - 1e-6 * (needless(frame) and frame.leave_out("light", "none")))


calls = itertools.count()

broken("image_is_visibility", "more light than there is", lambda v, frame: 1.5 * v)
broken("image_is_visibility", "negative light", lambda v, frame: v - 0.1)
broken("image_is_visibility", "no number", nan_in_corner)
broken("image_is_visibility", "another size", lambda v, frame: v[:-2])
broken(
    "a_scene_without_meshes_is_no_error",
    "takes the first vertex for granted",
    lambda v, frame: v + 0.0 * frame.geometry.points_ws.numpy()[0, 0],
)
broken(
    "same_bits_on_any_number_of_threads",
    "depends on the threads",
    lambda v, frame: v * (1.0 - 1e-6 * (frame.threads or 0)),
)
broken("same_bits_from_the_same_seed", "depends on what ran before", lambda v, frame: v / (1.0 + 1e-6 * next(calls)))
broken("without_casters_all_is_lit", "a grey veil", lambda v, frame: 0.999 * v)
broken("behind_an_opaque_slab_all_is_dark", "a leak", lambda v, frame: np.maximum(v, 0.01))
broken(
    "turning_the_world_changes_nothing",
    "knows where up is",
    lambda v, frame: v * (0.5 + 0.5 * np.abs(normal(frame)[..., 1])),
)
broken(
    "moving_the_world_a_million_units_changes_nothing",
    "positions without rebasing",
    lambda v, frame: v * (np.abs(frame.geometry.origin_ws).max() < 1e5),
)
broken("inputs_are_left_untouched", "writes to the G-buffer", write_to_gbuffer)
broken("inputs_are_left_untouched", "writes to the geometry", write_to_geometry)
broken("skips_change_no_bit", "a skip that shows", lambda v, frame: v * (1.0 - 1e-6 * frame.leave_out("light", "none")))
broken("skips_change_no_bit", "shows without area", shows_where(lambda frame: not frame.light.has_area))
broken("skips_change_no_bit", "shows after a while", shows_where(lambda frame: frame.count > 3))
broken("skips_change_no_bit", "shows with movers", shows_where(lambda frame: frame.geometry.moving))
broken("skips_change_no_bit", "shows without casters", shows_where(lambda frame: not frame.geometry.caster_triangles))
broken("skips_change_no_bit", "shows in the dark", shows_where(lambda frame: frame.light.centre[1] < 0.0))
broken("skips_change_no_bit", "skips all the same", lambda v, frame: frame.record("light", "none") or v)
broken(
    "every_light_kind_casts_its_shadow",
    "knows no lines",
    lambda v, frame: np.ones_like(v) if frame.light.kind == "linear" else v,
)
broken("every_light_kind_casts_its_shadow", "shadows elsewhere", lambda v, frame: np.roll(v, 20, axis=1))
broken(
    "a_cut_out_caster_shades_by_what_is_left_of_it",
    "draws whole cards",
    lambda v, frame: (
        np.where(np.abs(position(frame)[..., [0, 2]]).max(axis=-1) < 1.2, 0.0, v) if frame.geometry.cutouts.count else v
    ),
)
broken(
    "a_cut_out_receiver_shows_what_is_left_of_it",
    "shows shadows on whole cards",
    lambda v, frame: (
        np.where(np.abs(position(frame)[..., [0, 2]]).max(axis=-1) < 1.0, 0.5 * v, v)
        if frame.geometry.cutouts.count
        else v
    ),
)
broken("equals_others_in_its_limits", "is not what it claims", limits=(Limit(equals="ray_cast_point_shadow"),))
broken("equals_others_in_its_limits", "a shifted image", shift_one_pixel)
broken("bias_sign_is_as_declared", "darker", lambda v, frame: v**1.5)
broken("bias_sign_is_as_declared", "lighter", lambda v, frame: v**0.6)
broken("bias_sign_is_as_declared", "declared lighter, but darker", lambda v, frame: v**1.5, bias_sign="lighter")
broken("bias_sign_is_as_declared", "declared darker, but lighter", lambda v, frame: v**0.6, bias_sign="darker")
broken("bias_sign_is_as_declared", "declared lighter, but neither", lambda v, frame: v, bias_sign="lighter")
broken("bias_sign_is_as_declared", "declared darker, but neither", lambda v, frame: v, bias_sign="darker")
broken(
    "bias_sign_is_as_declared",
    "darker everywhere, though declared to turn",
    lambda v, frame: v**1.5,
    bias_sign="darker",
    bias_turns="it does not",
)
broken("bias_sign_is_as_declared", "leaks where two casters hide the light", lambda v, frame: np.maximum(v, 0.005))
broken("bias_sign_is_as_declared", "lighter in one, darker in the other", leak_and_darken, bias_sign="lighter")


# ---- sequences ------------------------------------------------------------------------------------------------------


def accumulate() -> Spoil:
    """A running mean over the session's frames, pixel by pixel, without reprojection."""
    held: WeakKeyDictionary[Frame, tuple[np.ndarray, int]] = WeakKeyDictionary()

    def spoil(v: np.ndarray, frame: Frame) -> np.ndarray:
        total, count = held.get(frame, (np.zeros_like(v), 0))
        held[frame] = (total + v, count + 1)
        return (total + v) / (count + 1)

    return spoil


def fade_in() -> Spoil:
    """Brightens with every frame of a session, which a reset should undo."""
    seen: WeakKeyDictionary[Frame, int] = WeakKeyDictionary()

    def spoil(v: np.ndarray, frame: Frame) -> np.ndarray:
        seen[frame] = seen.get(frame, 0) + 1
        return v * (1.0 - 0.1 / seen[frame])

    return spoil


def one_sample(v: np.ndarray, frame: Frame) -> np.ndarray:
    """As noisy after a hundred frames as after one."""
    return (np.random.default_rng(frame.count).random(v.shape) < v).astype(float)


def stale_product(v: np.ndarray, frame: Frame) -> np.ndarray:
    """Keeps the image of the first frame although casters and camera moved."""
    kept: np.ndarray = frame.product("image", "image", "never changes", lambda old: v)
    return kept


remembers = Needs(history=True)
broken("earlier_frames_leave_no_trace", "keeps a product whose inputs changed", stale_product)
broken("earlier_frames_leave_no_trace", "accumulates without saying so", accumulate())
broken("a_still_view_converges", "noise for ever", one_sample, needs=remembers)
broken("a_still_view_converges", "converges to something else", lambda v, frame: 0.8 * v, needs=remembers)
broken("disoccluded_pixels_ignore_history", "trails over the screen", accumulate(), needs=remembers)
broken("a_reset_forgets_everything", "a memory outside the frame", fade_in(), needs=remembers)
