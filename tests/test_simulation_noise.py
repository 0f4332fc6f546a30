"""What the simulator adds to the outline: its statistics are the ones stated, its seeds hold, its obstacles hide."""

import math

import msgspec
import numpy as np
import pytest
from scipy import stats

from planeopt.errors import InputError
from planeopt.simulation import (
    BeamProfile,
    Clutter,
    Noise,
    Occlusion,
    Optics,
    Scene,
    Sensor,
    Surface,
    boundary_distances,
    clean_light,
    render,
    true_record,
)
from planeopt.simulation.surroundings import smooth_field, speckle
from simulation_cases import SILENT, outline, spot_scene

replace = msgspec.structs.replace


def isf(share: float) -> float:
    """The quantile of the normal distribution that is exceeded with this probability."""
    return float(stats.norm.isf(share))


# Every bound below is two-sided at this level, Bonferroni shared between the cases of a test.
LEVEL = 1e-3

EVERYTHING = replace(
    spot_scene(30, 30),
    beam=BeamProfile(unevenness=0.1),
    surface=Surface(texture=0.05, gradient=(0.02, 0.03)),
    noise=Noise(speckle=0.3),
    clutter=Clutter(count=6),
    occlusions=(Occlusion(share=0.2, brightness=0.05),),
    optics=Optics(halo=0.05, vignetting=0.2),
)


def test_the_same_seed_gives_the_same_bytes_and_another_one_does_not():
    first, second = render(EVERYTHING), render(EVERYTHING, seed=EVERYTHING.seed)
    assert first.image.tobytes() == second.image.tobytes()
    assert first.truth == second.truth
    assert np.mean(render(EVERYTHING, seed=1).image == first.image) < 0.5
    assert np.array_equal(render(replace(EVERYTHING, seed=1)).image, render(EVERYTHING, seed=1).image)


@pytest.mark.parametrize("part", ["clutter", "surface", "occlusions", "optics"])
def test_leaving_one_part_out_leaves_the_noise_as_it_is(part: str):
    default = {"clutter": Clutter(), "surface": Surface(), "occlusions": (), "optics": Optics()}[part]
    quiet = replace(EVERYTHING, noise=Noise(full_well_electrons=0, read=0.02), sensor=Sensor(bits=16))
    changed = replace(quiet, **{part: default})
    noise = [render(scene).image / 65535 - clean_light(scene) for scene in (quiet, changed)]
    # Where neither is cut off at black or white: far from both.
    inside = (clean_light(quiet) > 0.1) & (clean_light(quiet) < 0.9)
    inside &= (clean_light(changed) > 0.1) & (clean_light(changed) < 0.9)
    assert np.count_nonzero(inside) > 500
    assert np.max(np.abs(noise[0] - noise[1])[inside]) < 1.1 / 65535


@pytest.mark.parametrize(("background", "electrons", "read"), [(0.3, 5000, 0.0), (0.004, 5000, 0.0), (0.2, 0, 0.01)])
def test_shot_and_read_noise_have_their_variance(background: float, electrons: float, read: float):
    scene = replace(
        spot_scene(20, 10),
        surface=Surface(background=background),
        noise=Noise(full_well_electrons=electrons, read=read),
        sensor=Sensor(bits=16),
    )
    values = render(scene, laser=False).image.ravel() / 65535
    variance = read**2 + (background / electrons if electrons else 0)
    n = values.size
    assert values.mean() == pytest.approx(background, abs=isf(LEVEL / 12) * math.sqrt(variance / n))
    # The variance of a variance; a Poisson's excess kurtosis adds 1 over its mean.
    excess = 1 / (background * electrons) if electrons else 0
    spread = math.sqrt((2 + excess) / n) * isf(LEVEL / 12)
    assert values.var() == pytest.approx(variance, rel=spread)
    if background * (electrons or math.inf) < 50:
        assert stats.skew(values) == pytest.approx(1 / math.sqrt(background * electrons), abs=0.03)


@pytest.mark.parametrize("contrast", [1.0, 0.6, 0.35, 0.1])
def test_speckle_has_its_contrast_mean_and_grain(contrast: float):
    grain = 1.2
    fields = np.stack([speckle((256, 256), contrast, grain, np.random.default_rng((5, k))) for k in range(12)])
    assert fields.min() >= 0
    # Independent samples: the area over the integral of the squared autocorrelation (of the autocorrelation, for the
    # mean), 2 pi grain^2 and half of that.
    for_mean = fields.size / (2 * math.pi * grain**2)
    n = math.floor(contrast**-2 + 1e-9) if contrast > 0.25 else 16
    z = isf(LEVEL / 8)
    assert fields.mean() == pytest.approx(1, abs=z * contrast / math.sqrt(for_mean))
    # A gamma of shape n has an excess kurtosis of 6/n.
    assert fields.var() == pytest.approx(contrast**2, rel=z * math.sqrt((2 + 6 / n) / for_mean))
    deviation = fields - 1
    for lag in (1, 2, 3):
        along = np.mean(deviation[:, :, lag:] * deviation[:, :, :-lag]) / fields.var()
        down = np.mean(deviation[:, lag:] * deviation[:, :-lag]) / fields.var()
        # A generous bound: the spread of a sample correlation is below that of uncorrelated samples that few.
        bound = 2 * z * math.sqrt((1 + 6 / n) / for_mean)
        assert along == pytest.approx(math.exp(-(lag**2) / (2 * grain**2)), abs=bound)
        assert down == pytest.approx(math.exp(-(lag**2) / (2 * grain**2)), abs=bound)


def test_full_speckle_is_exponential():
    field = speckle((400, 400), 1.0, 1.0, np.random.default_rng(3))[::8, ::8]
    # Pixels eight grains apart are independent.
    assert stats.kstest(field.ravel(), "expon").pvalue > LEVEL


@pytest.mark.parametrize("width", [0.0, 0.7, 3.0])
def test_smooth_fields_are_unit_normal(width: float):
    field = smooth_field((600, 600), width, np.random.default_rng(2))
    count = field.size / max(1.0, 4 * math.pi * width**2)
    assert field.var() == pytest.approx(1, abs=4 * math.sqrt(2 / count))


def test_speckle_is_on_the_laser_alone_and_the_mean_is_the_clean_light():
    scene = replace(spot_scene(15, 20, size=(120, 100)), surface=Surface(background=0.2), beam=BeamProfile(height=0.5))
    clean = clean_light(scene)
    noisy = replace(scene, noise=replace(SILENT, speckle=0.4))
    images = np.stack([clean_light(noisy, seed) for seed in range(400)])
    assert np.max(np.abs(images[:, 0] - 0.2)) < 1e-12
    error = (images.mean(axis=0) - clean) / np.maximum(0.4 * (clean - 0.2) / 20, 1e-9)
    # The largest of 12,000 means of 400 gammas.
    assert np.max(np.abs(error[clean > 0.21])) < isf(LEVEL / 12_000)


@pytest.mark.parametrize("bits", [8, 10, 12, 16])
def test_depth_fills_its_range(bits):
    scene = replace(spot_scene(30, 30), sensor=Sensor(bits=bits), beam=BeamProfile(height=2.0))
    image = render(scene).image
    assert image.dtype == (np.uint8 if bits == 8 else np.uint16)
    assert (image.min(), image.max()) == (0, np.iinfo(image.dtype).max)
    light = np.clip(clean_light(scene), 0, 1)
    top = 2**bits - 1
    assert np.max(np.abs(image / np.iinfo(image.dtype).max - light)) < 0.5 / top + 0.5 / 65535 + 1e-12
    assert 100 < len(np.unique(image)) <= 2**bits


def test_response_and_colour():
    scene = replace(spot_scene(30, 30), sensor=Sensor(gamma=2.2), beam=BeamProfile(height=0.5))
    middle = tuple(outline(scene).mean(axis=0).astype(int)[::-1])
    assert render(scene).image[middle] == round(255 * 0.5 ** (1 / 2.2))
    colour = replace(
        scene,
        sensor=Sensor(color=True),
        beam=BeamProfile(height=0.6, rgb=(1, 1 / 3, 0)),
        surface=Surface(background=0.2),
    )
    image = render(colour).image
    assert image.shape == (720, 960, 3)
    assert image[middle].tolist() == [51, 102, 204]
    assert image[0, 0].tolist() == [51, 51, 51]


def test_texture_halo_vignetting_and_gradient():
    scene = spot_scene(20, 0)
    plain = clean_light(scene)
    halo = clean_light(replace(scene, optics=Optics(blur_px=0.9, halo=0.2, halo_px=25)))
    wide = halo - 0.8 * plain
    # All but what falls outside of the image arrives, as a Gaussian of that width round the spot.
    assert wide.sum() == pytest.approx(0.2 * plain.sum(), rel=1e-3)
    x = np.arange(960)
    spread = np.sum(wide * x**2) / wide.sum() - (np.sum(wide * x) / wide.sum()) ** 2
    disc = np.sum(plain * x**2) / plain.sum() - (np.sum(plain * x) / plain.sum()) ** 2
    assert spread - disc == pytest.approx(25**2, rel=0.02)
    camera = scene.rig.camera
    dark = clean_light(
        replace(scene, surface=Surface(background=0.4, gradient=(0.1, 0.0)), optics=Optics(vignetting=0.3)), laser=False
    )
    corner = max(((cx - camera.cx) ** 2 + (cy - camera.cy) ** 2, cx, cy) for cx in (0, 959) for cy in (0, 719))
    assert dark[corner[2], corner[1]] == pytest.approx(0.7 * (0.4 + 0.1 * (corner[1] - 479.5) / 960), rel=1e-12)
    textured = clean_light(replace(scene, surface=Surface(background=0.4, texture=0.1, texture_px=2.0)), laser=False)
    assert textured.std() == pytest.approx(0.04, rel=0.02)
    lag = np.corrcoef(textured[:, 2:].ravel(), textured[:, :-2].ravel())[0, 1]
    assert lag == pytest.approx(math.exp(-0.5), abs=0.02)


def test_an_uneven_plateau_varies_as_stated():
    scene = spot_scene(100, 0, beam=BeamProfile(height=1, unevenness=0.05, unevenness_radii=0.3))
    inside = boundary_distances(scene, points := np.argwhere(clean_light(scene) > 0.5)[::50, ::-1].astype(float)) < -5
    rows, columns = points[inside].astype(int)[:, ::-1].T
    values = np.concatenate([clean_light(scene, seed)[rows, columns] for seed in range(30)])
    # About pi / (2 pi 0.3^2) independent places in each of 30 draws of 48 waves.
    assert values.std() == pytest.approx(0.05, rel=4 * math.sqrt(1 / (2 * 30 * 5.5)))


OBSTACLES = {
    "half plane": Occlusion(share=0.35),
    "bar": Occlusion(shape="bar", share=0.35, direction_deg=20),
    "bar off the middle": Occlusion(shape="bar", share=0.35, direction_deg=20, offset_px=12),
    "disc": Occlusion(shape="disc", share=0.35, brightness=0.3),
}


@pytest.mark.parametrize("obstacle", OBSTACLES.values(), ids=OBSTACLES.keys())
def test_obstacles_hide_the_share_asked_for(obstacle: Occlusion):
    scene = replace(spot_scene(30, 50, offset=(100, 50)), occlusions=(obstacle,))
    record = true_record(scene)
    # 720 points of the boundary are counted.
    assert record.arc_fraction == pytest.approx(0.65, abs=2 / 720)
    if obstacle.direction_deg is None:
        assert not np.array_equal(clean_light(scene, 1), clean_light(scene, 2))
    points = np.rint(outline(scene, 400)).astype(int)
    bare = clean_light(replace(scene, occlusions=()))
    light = clean_light(scene)
    kept = np.isclose(light, bare, atol=1e-6)[points[:, 1], points[:, 0]]
    covered = np.isclose(light, obstacle.brightness, atol=1e-6)[points[:, 1], points[:, 0]]
    # Equal steps of angle are not equal steps of length, and a few pixels are half hidden.
    assert 0.55 < kept.mean() < 0.75
    assert 0.2 < covered.mean() < 0.4


def test_obstacles_of_a_stated_extent():
    scene = spot_scene(30, 0)
    x, y = outline(scene).mean(axis=0)

    def hidden(obstacle: Occlusion) -> float:
        light = clean_light(
            replace(scene, surface=Surface(background=1.0), beam=BeamProfile(height=1e-9), occlusions=(obstacle,))
        )
        return float(np.sum(1 - light))

    assert hidden(Occlusion(shape="disc", size_px=20, centre_px=(300, 300))) == pytest.approx(math.pi * 400, rel=0.01)
    square = ((100.0, 100.0), (160.0, 100.0), (160.0, 140.0), (100.0, 140.0))
    assert hidden(Occlusion(shape="polygon", points_px=square)) == pytest.approx(2400, rel=0.01)
    assert hidden(Occlusion(shape="bar", size_px=7, direction_deg=0)) == pytest.approx(7 * 720, rel=0.001)
    assert hidden(Occlusion(offset_px=10, direction_deg=90)) == pytest.approx(960 * (719.5 - y - 10), rel=0.001)
    assert hidden(Occlusion(offset_px=10, direction_deg=180)) == pytest.approx(720 * (x - 10 + 0.5), rel=0.001)
    assert hidden(Occlusion(shape="disc", size_px=9, direction_deg=45)) == pytest.approx(math.pi * 81, rel=0.02)


def test_clutter_keeps_away_and_is_as_many_and_as_bright_as_asked():
    table = Clutter(count=12, height_range=(0.5, 0.9), size_range_px=(4, 9), keep_away_px=15)
    scene = replace(spot_scene(30, 30), clutter=table)
    bare = clean_light(replace(scene, clutter=Clutter()))
    for seed in range(5):
        added = clean_light(scene, seed) - bare
        assert added.sum() > 12 * 0.5 * 4
        lit = np.argwhere(added > 1e-3)[:, ::-1].astype(float)
        # A blob ends at three standard deviations, where it has 1 % of its height.
        assert boundary_distances(scene, lit).min() > 14
        assert added.max() > 0.45
    one = replace(
        scene, clutter=replace(table, count=1, kinds=("disc",), height_range=(0.5, 0.5), size_range_px=(8, 8))
    )
    added = clean_light(one) - bare
    assert added.max() == pytest.approx(0.5, abs=1e-6)


def test_clutter_without_room_is_refused():
    scene = replace(spot_scene(30, 30, size=(120, 100)), clutter=Clutter(count=1, size_range_px=(30, 30)))
    with pytest.raises(InputError, match=r"^clutter: there is no room"):
        render(scene)


def test_an_image_without_laser_shows_the_same_surroundings():
    dark, lit = clean_light(EVERYTHING, laser=False), clean_light(EVERYTHING)
    assert np.count_nonzero(lit - dark > 0.1) > 500
    assert np.min(lit - dark) > -1e-12
    images = [render(EVERYTHING, laser=laser).image[:50].astype(float) for laser in (True, False)]
    # Noise of its own: far from the spot the difference of the two has twice the variance.
    assert np.std(images[0] - images[1]) > 0.5


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: BeamProfile(height=-1), "beam.height must be above 0"),
        (lambda: BeamProfile(kind="square"), "beam.kind must be one of disc, ring, gaussian, not 'square'"),  # type: ignore[arg-type]  # that is the test
        (lambda: BeamProfile(slope=(0, math.nan)), "beam.slope must be a finite number"),
        (lambda: BeamProfile(level=1.0), "beam.level must be below 1"),
        (lambda: Optics(blur_px=0.1), "optics.blur_px must be at least 0.2"),
        (lambda: Noise(speckle=1.5), "noise.speckle must be at most 1"),
        (lambda: Occlusion(shape="bar"), "occlusion: a bar takes either share or size_px"),
        (lambda: Occlusion(share=0.3, offset_px=3), "occlusion: a half_plane takes either share or offset_px"),
        (lambda: Occlusion(shape="polygon", points_px=((0, 0), (1, 1))), "occlusion.points_px: a polygon takes three"),
        (lambda: Clutter(height_range=(1, 0.5)), r"clutter.height_range must be \[lowest, highest\]"),
        (lambda: Clutter(count=1, kinds=()), "clutter.kinds must name at least one kind"),
        (lambda: Clutter(size_range_px=(0, 5)), "clutter.size_range_px must be above 0"),
    ],
)
def test_impossible_numbers_are_refused_by_name(make, message: str):
    with pytest.raises(InputError, match=message):
        make()


def test_scene_is_a_value():
    scene: Scene = spot_scene()
    assert scene == spot_scene()
    assert replace(scene, seed=3) != scene
