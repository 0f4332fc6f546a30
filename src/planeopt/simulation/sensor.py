"""From light to grey values: shot and read noise, saturation, response, quantisation."""

from functools import reduce

import numpy as np
from numpy.typing import NDArray

from planeopt.simulation.tables import Noise, Sensor

Array = NDArray[np.float64]

# Below this many electrons the normal distribution is no longer a fair Poisson.
_FEW = 50.0


def expose(light: Array, noise: Noise, sensor: Sensor, rng: np.random.Generator) -> NDArray[np.unsignedinteger]:
    """Return the grey values (...) of light (...), a share of full scale.

    Shot noise (where `full_well_electrons` is given) is Poisson: exact where there are fewer than 50 electrons, normal
    with the same variance where there are more. Read noise is added, the sum is cut off at black and full scale, goes
    through the response and is rounded.
    """
    signal: Array = np.maximum(light, 0.0)
    variance: Array | float = noise.read**2
    if noise.full_well_electrons:
        variance = variance + signal / noise.full_well_electrons
        few = signal * noise.full_well_electrons < _FEW
        if np.any(few):
            electrons = rng.poisson(signal[few] * noise.full_well_electrons)
            signal = signal.copy()
            signal[few] = electrons / noise.full_well_electrons
            variance = np.where(few, noise.read**2, variance)
    if np.any(variance):
        signal = signal + np.sqrt(variance) * rng.standard_normal(signal.shape, dtype=np.float32).astype(np.float64)
    return quantise(signal, sensor)


def quantise(light: Array, sensor: Sensor) -> NDArray[np.unsignedinteger]:
    """Return the grey values of light that already carries its noise; more than 8 bits are stretched to 65535."""
    recorded = np.clip(light, 0.0, 1.0)
    if sensor.gamma != 1:
        recorded = recorded ** (1 / sensor.gamma)
    top = 2**sensor.bits - 1
    levels = np.rint(recorded * top)
    if sensor.bits == 8:
        return levels.astype(np.uint8)
    return np.rint(levels * (65535 / top)).astype(np.uint16)


def channels(parts: list[tuple[Array, tuple[float, float, float]]], sensor: Sensor) -> Array:
    """Return the light of all parts, (H, W), or (H, W, 3) in the order blue, green, red.

    Parameters
    ----------
    parts : list of (light, rgb)
        A grey camera sees the light as it is.
    """
    if not sensor.color:
        return reduce(np.add, [light for light, _ in parts])
    seen = [reduce(np.add, [light * rgb[channel] for light, rgb in parts]) for channel in (2, 1, 0)]
    return np.stack(seen, axis=-1)
