"""The tables of a scene: what each number means, its unit, its default and its limits.

The same classes serve Python and `scene.toml`. Brightness is linear light as a share of the camera's full scale:
0 is black, 1 is where the sensor saturates.
"""

import math
from typing import Annotated, Any, ClassVar, Literal, get_args, get_origin, get_type_hints

import msgspec
from msgspec import Meta

from planeopt.errors import InputError

Share = Annotated[float, Meta(ge=0, le=1)]
Positive = Annotated[float, Meta(gt=0)]
NotNegative = Annotated[float, Meta(ge=0)]
# Of anything that is laid over the image: a filter beyond takes more memory than there is.
Pixels = Annotated[float, Meta(ge=0, le=1000)]
Pair = tuple[float, float]
Triple = tuple[float, float, float]
Range = tuple[float, float]

BeamKind = Literal["disc", "ring", "gaussian"]
Shape = Literal["half_plane", "bar", "disc", "polygon"]
ClutterKind = Literal["blob", "disc", "rectangle", "streak"]


class Table(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A table of a scene; numbers are checked however it is made."""

    key: ClassVar[str] = ""

    def __post_init__(self) -> None:
        for name, hint in get_type_hints(type(self), include_extras=True).items():
            if name != "key" and get_origin(hint) is not ClassVar:
                _check(f"{self.key}.{name}", getattr(self, name), hint)


def _check(key: str, value: Any, hint: Any) -> None:
    """Raise an `InputError` that names the key where a number is not finite or outside its limits."""
    if get_origin(hint) is Literal:
        if value not in get_args(hint):
            raise InputError(f"{key} must be one of {', '.join(map(str, get_args(hint)))}, not {value!r}")
        return
    if value is None or isinstance(value, str | bool | dict | Table):
        return
    if isinstance(value, tuple):
        inner = get_args(hint)
        for part in value:
            _check(key, part, inner[0] if inner else float)
        return
    if not math.isfinite(value):
        raise InputError(f"{key} must be a finite number, not {value}")
    for limit in (part for part in _metas(hint) if isinstance(part, Meta)):
        if limit.ge is not None and value < limit.ge:
            raise InputError(f"{key} must be at least {limit.ge}, not {value}")
        if limit.gt is not None and value <= limit.gt:
            raise InputError(f"{key} must be above {limit.gt}, not {value}")
        if limit.lt is not None and value >= limit.lt:
            raise InputError(f"{key} must be below {limit.lt}, not {value}")
        if limit.le is not None and value > limit.le:
            raise InputError(f"{key} must be at most {limit.le}, not {value}")


def _metas(hint: Any) -> list[Any]:
    found = list(getattr(hint, "__metadata__", ()))
    return found + [meta for part in get_args(hint) for meta in getattr(part, "__metadata__", ())]


def _ordered(key: str, limits: Range | None) -> None:
    if limits is not None and limits[0] > limits[1]:
        raise InputError(f"{key} must be [lowest, highest], not {list(limits)}")


class BeamProfile(Table, frozen=True):
    """How the laser's light is spread over the beam's cross-section, before the camera's blur.

    `rho` below is the distance from the beam's axis over its radius, so that the true boundary is at `rho = 1`.

    Parameters
    ----------
    kind : {"disc", "ring", "gaussian"}
        `disc`: a plateau with an edge; `ring`: a Gaussian line along the radius; `gaussian`: `level ** (rho ** order)`.
    height : float
        Brightness of the plateau (ridge, peak) above the background, share of full scale; above 1 it is over-exposed.
    edge_mm : float
        A disc's own softness: standard deviation of the Gaussian that its edge is the integral of, in the
        cross-section, mm; 0 is sharp.
    line_mm : float
        Standard deviation of a ring's line in the cross-section, mm.
    level : float
        Share of the plateau (peak) that a soft disc (a Gaussian beam) has at the beam's radius, between 0 and 1.
    order : float
        Of a Gaussian beam: 2 is Gaussian, more is flatter.
    slope : (float, float)
        Relative change of brightness over one radius, along the laser-parallel frame's x and y.
    bowl : float
        Relative change of brightness from the axis to the radius, growing with `rho ** 2`.
    unevenness : float
        Standard deviation of a smooth random relative change of brightness.
    unevenness_radii : float
        Its correlation length (the standard deviation of its Gaussian autocorrelation), in beam radii.
    astigmatism : float
        A dirty beam: a contour at another level than `level` (a ring's: than its ridge) is an ellipse, not a circle;
        its semi-axes differ by twice this times the difference of level, relatively. A sharp edge does not show it.
    astigmatism_deg : float
        Direction of that in the cross-section, from x to y.
    fringes : float
        Amplitude of straight interference fringes, share of the local brightness.
    fringe_mm : float
        Their period in the cross-section, mm.
    fringe_deg : float
        Direction in which they change, from x to y.
    rgb : (float, float, float)
        Of a colour camera: what the red, green and blue channels see of this light.
    """

    key: ClassVar[str] = "beam"

    kind: BeamKind = "disc"
    height: Annotated[float, Meta(gt=0, le=1000)] = 0.6
    edge_mm: NotNegative = 0.0
    line_mm: Positive = 0.3
    level: Annotated[float, Meta(gt=0, lt=1)] = 0.5
    order: Annotated[float, Meta(ge=2, le=100)] = 2.0
    slope: Pair = (0.0, 0.0)
    bowl: float = 0.0
    unevenness: NotNegative = 0.0
    unevenness_radii: Annotated[float, Meta(ge=0.1)] = 0.5
    astigmatism: Annotated[float, Meta(ge=0, le=0.5)] = 0.0
    astigmatism_deg: float = 0.0
    fringes: Share = 0.0
    fringe_mm: Positive = 2.0
    fringe_deg: float = 0.0
    rgb: Triple = (1.0, 0.1, 0.05)


class Optics(Table, frozen=True):
    """The lens.

    Parameters
    ----------
    blur_px : float
        Standard deviation of the Gaussian blur, px, at least 0.2; the average over the pixel's area (its full pitch)
        comes on top of it.
    halo : float
        Share of the spot's light that is scattered into a wide halo.
    halo_px : float
        Standard deviation of the halo, px.
    vignetting : float
        Share of the light that is missing in the corner furthest from the principal point, growing with the square of
        the distance.
    """

    key: ClassVar[str] = "optics"

    blur_px: Annotated[float, Meta(ge=0.2, le=50)] = 1.0
    halo: Share = 0.0
    halo_px: Annotated[float, Meta(ge=1, le=1000)] = 30.0
    vignetting: Share = 0.0


class Surface(Table, frozen=True):
    """What the plane looks like without the laser.

    Parameters
    ----------
    background : float
        Brightness in the image's centre, share of full scale.
    gradient : (float, float)
        Change of that over the image's width and height, share of full scale.
    texture : float
        Standard deviation of a random relative change of reflectance, as it is seen in the image: of the background and
        of the laser's light alike.
    texture_px : float
        Its correlation length (the standard deviation of its Gaussian autocorrelation), px; 0 is white.
    rgb : (float, float, float)
        Of a colour camera: what the red, green and blue channels see of the background.
    """

    key: ClassVar[str] = "surface"

    background: Annotated[float, Meta(ge=0, le=1000)] = 0.08
    gradient: Pair = (0.0, 0.0)
    texture: Annotated[float, Meta(ge=0, le=10)] = 0.0
    texture_px: Pixels = 3.0
    rgb: Triple = (1.0, 1.0, 1.0)


class Noise(Table, frozen=True):
    """What differs between two images of the same scene.

    Parameters
    ----------
    speckle : float
        Contrast of the laser's speckle as the pixels record it: standard deviation over mean of its intensity, 0 to 1.
    speckle_grain_px : float
        Standard deviation of the Gaussian autocovariance of that intensity, px: two pixels a distance d apart are
        correlated by exp(-d^2 / (2 grain^2)).
    full_well_electrons : float or None
        Electrons at full scale, whose number is Poisson distributed; 0 (or None, in Python): no shot noise.
    read : float
        Standard deviation of the read noise, share of full scale (a grey level of 8 bits is 1/255).
    """

    key: ClassVar[str] = "noise"

    speckle: Share = 0.0
    speckle_grain_px: Pixels = 1.2
    full_well_electrons: NotNegative | None = 10000.0
    read: Share = 0.002


class Sensor(Table, frozen=True):
    """How light becomes grey values.

    Parameters
    ----------
    bits : {8, 10, 12, 16}
        Depth. 8 bits are stored as such; more are stored in 16 bits, stretched so that full scale is 65535.
    gamma : float
        Of the response: the recorded value is (light share) ** (1 / gamma); 1 is linear.
    color : bool
        Three channels instead of grey, without a mosaic.
    """

    key: ClassVar[str] = "sensor"

    bits: Literal[8, 10, 12, 16] = 8
    gamma: Positive = 1.0
    color: bool = False


class Occlusion(Table, frozen=True):
    """Something between the camera and the spot.

    Give its extent in px, or `share` of the boundary (that lies in the image) that it hides, from which the extent
    follows. Directions are in the image, from x to y; left out, they are drawn.

    Parameters
    ----------
    shape : {"half_plane", "bar", "disc", "polygon"}
        `half_plane`: all beyond a line; `bar`: a strip; `disc`; `polygon`: through `points_px`.
    brightness : float
        What the camera sees instead, share of full scale.
    share : float, optional
        Share of the boundary, by its length in the image, to hide.
    direction_deg : float, optional
        Of the line's normal (half plane and bar), or from the spot's centre to the disc's.
    offset_px : float
        Distance of the line (half plane) or of the strip's middle from the centre of the spot's image, px.
    size_px : float, optional
        Width of the strip, or radius of the disc.
    centre_px : (float, float), optional
        Of the disc, raw pixels; left out, it is on the spot's boundary in `direction_deg`.
    points_px : list of (float, float)
        Corners of the polygon, raw pixels.
    blur_px : float, optional
        Standard deviation of its edge, px; left out, that of the optics.
    """

    key: ClassVar[str] = "occlusion"

    shape: Shape = "half_plane"
    brightness: NotNegative = 0.0
    share: Annotated[float, Meta(ge=0, lt=1)] | None = None
    direction_deg: float | None = None
    offset_px: float | None = None
    size_px: Positive | None = None
    centre_px: Pair | None = None
    points_px: tuple[Pair, ...] = ()
    blur_px: Positive | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        extent = {"half_plane": "offset_px", "bar": "size_px", "disc": "size_px"}
        if self.shape == "polygon":
            if len(self.points_px) < 3 or self.share is not None:
                raise InputError("occlusion.points_px: a polygon takes three corners or more, and no share")
            return
        if (self.share is None) == (getattr(self, extent[self.shape]) is None):
            raise InputError(f"occlusion: a {self.shape} takes either share or {extent[self.shape]}")


class Clutter(Table, frozen=True):
    """Other bright things in view, drawn at random; they add to the light.

    Parameters
    ----------
    count : int
        How many.
    kinds : list of {"blob", "disc", "rectangle", "streak"}
        Taken in turn: a Gaussian blob, a filled disc, a filled rectangle, a Gaussian line.
    height_range : (float, float)
        Lowest and highest brightness, share of full scale.
    size_range_px : (float, float)
        Lowest and highest size: standard deviation of a blob, radius of a disc, half the longer side of a rectangle,
        half the length of a streak.
    keep_away_px : float
        Distance from the spot's boundary that they keep, px. (A blob and a streak end at three standard deviations.)
    """

    key: ClassVar[str] = "clutter"

    count: Annotated[int, Meta(ge=0, le=1000)] = 0
    kinds: tuple[ClutterKind, ...] = ("blob", "disc", "rectangle", "streak")
    height_range: tuple[NotNegative, NotNegative] = (0.2, 1.0)
    size_range_px: tuple[Positive, Positive] = (2.0, 15.0)
    keep_away_px: NotNegative = 10.0

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.count and not self.kinds:
            raise InputError("clutter.kinds must name at least one kind")
        _ordered("clutter.height_range", self.height_range)
        _ordered("clutter.size_range_px", self.size_range_px)


class Sweep(Table, frozen=True):
    """Ranges from which each image's plane is drawn, uniformly; what is left out stays as in the scene's plane.

    Parameters
    ----------
    z_L_mm, alpha_deg, beta_deg : (float, float), optional
        Lowest and highest.
    """

    key: ClassVar[str] = "sweep"

    z_L_mm: Range | None = None
    alpha_deg: tuple[Annotated[float, Meta(ge=0, lt=90)], Annotated[float, Meta(ge=0, lt=90)]] | None = None
    beta_deg: Range | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        for name in ("z_L_mm", "alpha_deg", "beta_deg"):
            _ordered(f"sweep.{name}", getattr(self, name))
