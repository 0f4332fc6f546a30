"""What the page of a calibration says in words: names of parameters, captions."""

SYMBOLS = {
    "f": "$f$",
    "fx": "$f_x$",
    "fy": "$f_y$",
    "cx": "$c_x$",
    "cy": "$c_y$",
    **{name: f"${name[0]}_{name[1]}$" for name in ("k1", "k2", "p1", "p2", "k3")},
    "warp_x": "$w_x$",
    "warp_y": "$w_y$",
    "e_x": "$e_x$",
    "e_y": "$e_y$",
    "radius": "$r$",
    "direction_x": "$d_x$",
    "direction_y": "$d_y$",
    "divergence": r"$\delta$",
}

NAMES = {
    "f": "focal length f (px)",
    "fx": "focal length fx (px)",
    "fy": "focal length fy (px)",
    "f_mm": "focal length f (mm)",
    "fx_mm": "focal length fx (mm)",
    "fy_mm": "focal length fy (mm)",
    "cx": "principal point cx (px)",
    "cy": "principal point cy (px)",
    **{name: f"radial distortion {name}" for name in ("k1", "k2", "k3")},
    **{name: f"tangential distortion {name}" for name in ("p1", "p2")},
    "warp_x": "bow of the board along x, w_x (mm)",
    "warp_y": "bow of the board along y, w_y (mm)",
    "e_x": "beam's offset e_x (mm)",
    "e_y": "beam's offset e_y (mm)",
    "radius": "beam's radius r (mm)",
    "direction_x": "beam's direction d_x",
    "direction_y": "beam's direction d_y",
    "divergence": "beam's divergence: growth of r per mm",
    "angle_x_mrad": "beam's angle to the optical axis towards x (mrad)",
    "angle_y_mrad": "beam's angle to the optical axis towards y (mrad)",
    "angle_mrad": "beam's angle to the optical axis (mrad)",
    "divergence_mrad": "beam's divergence, half angle (mrad)",
}

TERMS = {
    "k1": "radial distortion k1",
    "k2": "radial distortion k2",
    "tangential": "tangential distortion p1, p2",
    "k3": "radial distortion k3",
    "warp": "bow of the board",
    "aspect": "fx other than fy",
    "parallel": "angle between beam and optical axis",
    "divergence": "divergence of the beam",
}

UNITS = {
    "images": "share of the images",
    "marker size": "relative",
    "mirror": "share of the views",
    "views": "views",
    "spots": "views",
    "coverage": "share of the cells",
    "border": "share of the way",
    "tilt": "tilted views",
    "tilt directions": "directions",
    "one camera": "relative, of f",
    "spot distances": "ratio",
    "board distances": "ratio",
    "square proportion": "relative",
    "single views": "times the others",
    "one beam": "times the sigmas",
    "board bow": "mm",
    "board shape": "share of the misfit",
    "residuals": "px",
    "spot residuals": "px",
    "outliers": "share of the corners",
    "camera conditioning": "condition number",
    "beam conditioning": "condition number",
    "focal length": "relative sigma",
}
"""What the numbers of a condition are, by its name."""

VERDICTS = {
    "ok": "Good.",
    "degraded": "Usable with a reservation: read why before it is used.",
    "refused": "Refused: planes measured with this rig could not be defended.",
}

FORCED = (
    "It was refused and its rig.toml written all the same, because --force was given. The file says so, and so does "
    "whatever is measured with it."
)
NOT_WRITTEN = "No rig.toml was written; --force writes one that is marked as refused."

CAPTIONS = {
    "gates": (
        "What a good session meets, each with what was found, where it is ok and where it is refused; what is neither "
        "is warned of. What is beyond by no more than chance may give is ok as well. Good: all ok. A warning says what "
        "to do about it; so does a refusal, and the first one is the cause as a rule."
    ),
    "images": ("What became of each image. Good: all used, with a spot in most of them; what is not used says why."),
    "parameters": (
        "Of one joint adjustment, all residuals in pixels. The intervals are Gaussian, their sigma from the scatter of "
        "the residuals and, in the last column, what all observations without exception would give. Good: that is "
        "within a sigma or so of the value; f is known to 0.1 % or better; the beam's radius to some µm. Sigmas are of "
        "one parameter at a time: what a plane suffers follows from all together, below."
    ),
    "correlations": (
        "Correlations of all parameters, +1 to -1. Blue: they may both be too large; red: one too large, the other too "
        "small. Good: numbers near 1 only where the geometry makes them, between the principal point, the beam's "
        "direction (or offset) and p1, p2, which shift or turn the image alike. f near ±1 with anything else means "
        "views too much alike: more tilt, more depths."
    ),
    "cost": (
        "Standard deviations that the calibration alone gives a plane, without the noise of its spot. Filled: from the "
        "joint covariance, which is what rig.toml holds and planes are given. Hollow: what the same standard "
        "deviations would give if camera and beam were taken as independent of each other. Cross: those of e_x and e_y "
        "alone. Good: the filled dots well below what a plane has to be known to. How far left of the hollow ones they "
        "are shows what the joint covariance is worth: an error of the principal point comes with one of the beam that "
        "undoes it."
    ),
    "costs": (
        "The same in numbers; the tilt is that of the plane, beta its direction. Good: sigma well below what a plane "
        "has to be known to. No number of images of planes makes it smaller; a better calibration does."
    ),
    "ladder": (
        "The ladder of lens models, each rung against the one below. Unless one was asked for, all five coefficients "
        "are free and kept to what lenses do: one that is left out because its test sees nothing would make the "
        "intervals of the others too short. Good: the p of the last rung is not tiny, so that no further one is "
        "missing; f hardly moves over the last rungs."
    ),
    "tests": (
        "What else is in the model, or could be. Good: the board flat (no bow found), the pixels square, the beam "
        "without divergence. A beam that is not parallel to the optical axis is no fault: its direction is measured "
        "and allowed for."
    ),
    "vectors": (
        "What is left of each corner, observed minus predicted, all views on one image: left each, magnified; right "
        "the means of cells, magnified more, orange where chance gives so much in less than one picture of 100. Good: "
        "left arrows at random, right short ones and none orange. Neighbours that all point one way mean a lens that "
        "is not described, a bowed board, or corners measured with a bias."
    ),
    "strips": (
        "The same view by view, in standard deviations: above, x and y of each corner, with the root mean square as a "
        "bar; below, points of the spot's boundary, with the root mean square of the five numbers of its ellipse as a "
        "bar. Crosses were left out by rule. Good: all views alike, hardly a point beyond 3, bars of corners near 1, "
        "those of spots between 0.4 and 1.6 in 19 of 20 views, since five numbers tell no more. Points of a boundary "
        "may scatter less than the bar says: they are not independent, which their sigma allows for. One view that "
        "stands out was moved, blurred or is of another camera."
    ),
    "histogram": (
        "The distribution of all of these against the normal that is expected (of corners after the fit has taken its "
        "degrees of freedom). Good: the bars follow the line. Of the spots a narrower one is no fault: the boundary's "
        "points are not independent, which their sigma allows for. Heavy tails mean bad corners that stayed."
    ),
    "views": (
        "Root mean square of what is left, px; chi-squared of the spot at the level of its ellipse, of which 5 is "
        "expected; depth of the board's middle; tilt of the board against the optical axis. Good: all alike, "
        "chi-squared mostly below 11."
    ),
    "coverage": (
        "Where in the image corners were seen (dots), and the spots (lines); cells without a corner are grey. Good: "
        "corners everywhere, near the edges and in the corners of the image too; the lens is not known where none was. "
        "The spots lie on a line, the beam's image: they need depths, not coverage."
    ),
    "poses": (
        "Left, the tilts of the boards: distance from the middle is the angle to the optical axis, direction where the "
        "far side lay. Right, the depths of boards and spots. Good: tilts all round, five or more beyond 20 deg (the "
        "line); depths over a ratio of 1.5 or more, in three steps or more. Without tilts the focal length is not "
        "known, without depths the beam's direction."
    ),
    "beam": (
        "Each spot put back onto its board: above, where the beam's section is centred and how wide it is, against the "
        "distance along the beam; below, the same less the fitted beam, bars of 95 % from the boundary's noise alone. "
        "Band: 95 % of the fitted beam, with all that is uncertain of the camera, which moves points and line "
        "together. Good: the bars touch zero, without a bend or a slope. A slope of the radius is a divergence; one "
        "point off is a view whose spot or board is wrong."
    ),
    "warp": (
        "How the board departs from a plane, as found: two parabolas, one along x, one along y, zero at the edges' "
        "middle. Positive: farther from the camera; lines of equal depth bear it, negative ones are dashed, the thick "
        "one is zero. Good: below a twentieth of a millimetre. "
        "What is drawn was compensated; a board that is bowed in another shape is not."
    ),
    "held_out": (
        "Views that had no say, predicted by a calibration from the others: the error of half of their corners (the "
        "other half gives the pose) and of their spots against what noise and the calibration's own uncertainty lead "
        "one to expect, and the parameter that moved most, in standard deviations of such differences. Good: errors as "
        "expected, no parameter beyond 3 or 4. A board that is bowed or measured wrongly is not noticed by this: it is "
        "the same in all views."
    ),
    "with_all": (
        "Corners beyond 4 standard deviations (at most 3 %) and spots of no ellipse are left out by rule, never to "
        "reach a residual. Good: few left out, and nothing moved by more than a sigma."
    ),
}

JOINT = (
    "Why one joint covariance: camera and beam were told from the same images, and {pair} have a correlation of "
    "{value}. On its own the beam seems to be known badly, as badly as the principal point. A plane hardly suffers: a "
    "principal point that is off turns all rays a little, and a beam that was calibrated with these rays is off with "
    "them, so that where the two meet, on the plane, the error is nearly gone. Independent standard deviations cannot "
    "say this; the figure shows what they would claim."
)
