"""What a scene file may say (docs/formats.md), as pydantic models. Lengths in scene units, angles in degrees."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import AfterValidator, BeforeValidator, Field

from experiments.config.source import StrictModel

LARGEST = 1e12
"""Of a coordinate or length, so that squared lengths stay finite in float32."""

Coordinate = Annotated[float, Field(ge=-LARGEST, le=LARGEST)]
Positive = Annotated[float, Field(gt=0, le=LARGEST)]
NonNegative = Annotated[float, Field(ge=0, le=LARGEST)]
Vector3 = tuple[Coordinate, Coordinate, Coordinate]
Frame = Annotated[int, Field(ge=-1_000_000, le=1_000_000)]
Reflectance = Annotated[float, Field(ge=0, le=1)]
Name = Annotated[str, Field(min_length=1)]


def _once_per_axis(value: Any) -> Any:
    if isinstance(value, (int, float)) and not isinstance(value, bool):
        return (value, value, value)
    return tuple(value) if isinstance(value, list) else value  # after a validator, strict mode wants tuples


def _not_zero(value: Vector3) -> Vector3:
    if not any(value):
        raise ValueError("must not be the zero vector.")
    return value


Scale = Annotated[tuple[Positive, Positive, Positive], BeforeValidator(_once_per_axis)]
Direction = Annotated[Vector3, AfterValidator(_not_zero)]


class Transform(StrictModel):
    """Scale, then rotation about x, then y, then z (fixed axes), then translation.

    Attributes:
        translate: By how much, scene units.
        rotate_deg: Degrees about x, y and z.
        scale: Factors along x, y and z, or one for all.
    """

    translate: Vector3 = (0.0, 0.0, 0.0)
    rotate_deg: Vector3 = (0.0, 0.0, 0.0)
    scale: Scale = (1.0, 1.0, 1.0)


class MotionKeyframe(Transform):
    """A transform at a frame.

    Attributes:
        frame: Which; keyframes come in rising order.
    """

    frame: Frame


class Motion(StrictModel):
    """How a mesh or light moves.

    Attributes:
        keyframes: Linear in between; rotations the shorter way round, but angle by angle where one changes by 180
            degrees or more: 0 to 360 is a whole turn. The ends are held.
    """

    keyframes: Annotated[list[MotionKeyframe], Field(min_length=1)]


class MeshOptions(StrictModel):
    """Keys that every mesh takes.

    Attributes:
        name: Unique name; for a generator, a prefix of the names of its parts.
        transform: Where it stands.
        motion: Makes it a moving object; its keyframes act after ``transform``.
        diffuse: Reflectance, red, green, blue; 0.8 each, or what a generator chooses, unless given.
        casts: Whether it casts shadows.
        receives: Whether it receives them.
    """

    name: Name | None = None
    transform: Transform = Transform()
    motion: Motion | None = None
    diffuse: tuple[Reflectance, Reflectance, Reflectance] | None = None
    casts: bool = True
    receives: bool = True


class Box(MeshOptions):
    """A closed box centred on the origin."""

    primitive: Literal["box"]
    size: tuple[Positive, Positive, Positive]


class Cutout(StrictModel):
    """A texture that says where a surface is there, such as leaves on a card.

    Attributes:
        texture: An image file, relative to the scene file: its alpha, or its first channel where it has none.
        cutoff: Least alpha that is there.
        repeat: How often the texture is repeated along x and z.
        filter: Whether alpha is interpolated between texels before it is compared.
    """

    texture: Name
    cutoff: Annotated[float, Field(ge=0, le=1)] = 0.5
    repeat: tuple[Positive, Positive] = (1.0, 1.0)
    filter: Literal["linear", "nearest"] = "linear"


class FlatOptions(MeshOptions):
    """Keys that flat primitives take besides those of every mesh.

    Attributes:
        mask: Cuts it out by a texture that covers it once; techniques that need whole casters refuse it.
    """

    mask: Cutout | None = None


class Plane(FlatOptions):
    """Two triangles in XZ, normal +Y."""

    primitive: Literal["plane"]
    size: tuple[Positive, Positive]


class Disc(MeshOptions):
    """A disc in XZ, normal +Y."""

    primitive: Literal["disc"]
    radius: Positive


class Grid(FlatOptions):
    """cells x cells quads in XZ, normal +Y."""

    primitive: Literal["grid"]
    size: tuple[Positive, Positive]
    cells: Annotated[int, Field(ge=1, le=4096)]


class Sphere(MeshOptions):
    """A closed icosphere of 20 * 4^subdivisions triangles."""

    primitive: Literal["sphere"]
    radius: Positive
    subdivisions: Annotated[int, Field(ge=0, le=8)] = 3


class Cylinder(MeshOptions):
    """A closed cylinder along y."""

    primitive: Literal["cylinder"]
    radius: Positive
    height: Positive


class MeshFile(MeshOptions):
    """A mesh file, relative to the scene file, ``warp:NAME`` or ``fetched:NAME/FILE`` (``assets.find_file``)."""

    file: Name


PRIMITIVES: dict[str, type[MeshOptions]] = {
    "box": Box,
    "plane": Plane,
    "disc": Disc,
    "grid": Grid,
    "sphere": Sphere,
    "cylinder": Cylinder,
}


class LightOptions(StrictModel):
    """Keys that every light takes.

    Attributes:
        radiance: Red, green, blue: the colour of shading, and what the light weighs among several.
        motion: Moves it as meshes move, about the world's origin.
    """

    radiance: tuple[NonNegative, NonNegative, NonNegative] = (1.0, 1.0, 1.0)
    motion: Motion | None = None


class Point(LightOptions):
    """An omnidirectional point."""

    kind: Literal["point"]
    position: Vector3


class Directional(LightOptions):
    """Light that travels along ``direction``; ``angle_deg`` is the full angular diameter."""

    kind: Literal["directional"]
    direction: Direction
    angle_deg: Annotated[float, Field(ge=0, lt=180)] = 0.0


class Rectangle(LightOptions):
    """A parallelogram given by its centre and two full edges; a zero edge is allowed (the limit of a small light)."""

    kind: Literal["rectangle"]
    center: Vector3
    edge_u: Vector3
    edge_v: Vector3
    texture: Name | None = None


class SphereLight(LightOptions):
    """A sphere."""

    kind: Literal["sphere"]
    center: Vector3
    radius: NonNegative


class DiscLight(LightOptions):
    """A disc."""

    kind: Literal["disc"]
    center: Vector3
    normal: Direction
    radius: NonNegative


class Linear(LightOptions):
    """A segment."""

    kind: Literal["linear"]
    a: Vector3
    b: Vector3


class Polygon(LightOptions):
    """A planar convex polygon."""

    kind: Literal["polygon"]
    vertices: Annotated[list[Vector3], Field(min_length=3)]
    texture: Name | None = None


LIGHTS: dict[str, type[LightOptions]] = {
    "point": Point,
    "directional": Directional,
    "rectangle": Rectangle,
    "sphere": SphereLight,
    "disc": DiscLight,
    "linear": Linear,
    "polygon": Polygon,
}


class CameraOptions(StrictModel):
    """A pinhole camera, or an orthographic one.

    Attributes:
        eye: Where it stands; may be left to a path.
        target: What it looks at; likewise.
        up: Its vertical axis.
        projection: Whether lines of sight meet in the eye, or are parallel.
        fov_deg: Vertical field of view of a perspective camera.
        height: What an orthographic camera sees from top to bottom; it needs it, and no other has it.
        near: Near plane; 0.1, or what the scene needs where it is much larger or smaller.
        far: Far plane; 1000, likewise.
    """

    eye: Vector3 | None = None
    target: Vector3 | None = None
    up: Direction = (0.0, 1.0, 0.0)
    projection: Literal["perspective", "orthographic"] = "perspective"
    fov_deg: Annotated[float, Field(gt=0, lt=180)] = 60.0
    height: Positive | None = None
    near: Positive | None = None
    far: Positive | None = None


class CameraKeyframe(StrictModel):
    """Eye and target at a frame.

    Attributes:
        frame: Which; keyframes come in rising order.
        eye: Where the camera stands then.
        target: What it looks at then.
    """

    frame: Frame
    eye: Vector3
    target: Vector3


class Orbit(StrictModel):
    """A turn about a vertical axis, from +Z (0 degrees) towards +X.

    Attributes:
        center: On the axis; it is looked at.
        radius: Distance from the axis.
        height: Of the eye above ``center``.
        degrees: How far it turns in all frames.
        start_deg: Where it begins.
    """

    center: Vector3
    radius: Positive
    height: Coordinate = 0.0
    degrees: Coordinate = 360.0
    start_deg: Coordinate = 0.0


class PathOptions(StrictModel):
    """A camera path: ``frames`` and one of the other keys.

    Attributes:
        frames: How many there are; up to the last keyframe unless given. An orbit needs it.
        keyframes: Places between which the eye follows a smooth curve (Catmull and Rom).
        orbit: A turn about a point.
        file: Keyframes in a CSV or JSON file.
    """

    frames: Annotated[int, Field(ge=1, le=1_000_000)] | None = None
    keyframes: Annotated[list[CameraKeyframe], Field(min_length=1)] | None = None
    orbit: Orbit | None = None
    file: Name | None = None


class SceneFile(StrictModel):
    """The top level. Meshes and lights are checked one by one, against the model that their kind asks for.

    Attributes:
        meshes: What there is; see below.
        lights: What lights it, at least one; see below.
        camera: Where the eye is.
        path: How it moves; without one there is one frame.
    """

    meshes: list[Any]
    lights: Annotated[list[Any], Field(min_length=1)]
    camera: CameraOptions = CameraOptions()
    path: PathOptions | None = None
