"""Magnetic readings of eFlesh decoded without a design: force and place from 15 or 30 channels."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from dataset import Samples
from decoupler import NetworkConfig, train
from geometry.layout import AXES, FloatArray
from studies.real_rubber.readers import Pressed, read_recordings
from studies.tables import Row

REST = 2e4  #: added to changes of a channel [μT], which are then resistances [Ω]; the largest is a sixth of it
NOISE = 2.5e-4  #: of these: 5 μT, the channels' scatter at rest
HELD_OUT = 0.2  #: share of places; of a recording's end, as the paper's own split
PAPER = {"normal_force": "0.27 N", "shear_force": "0.12 N", "spatial_resolution": "0.5 mm"}


def samples(channels: FloatArray, wanted: FloatArray) -> Samples:
    """Channels as pillars of c/3 units, what is wanted of them as forces on each unit."""
    n, c = channels.shape
    force = np.zeros((n, 1, c // 3, len(AXES)))
    force[..., : wanted.shape[1]] = wanted[:, None, None]
    return Samples(resistance_ohm=channels.reshape(force.shape) + REST, force_n=force, noise=NOISE)


def decoded(learned: Pressed, channels: FloatArray) -> tuple[FloatArray, FloatArray]:
    """What is wanted (n, m), and half-widths that are to hold 95 % of the errors.

    Of readings at rest a tenth is learned from: error bars leave out all of a load at once, and rest is a fifth of all.
    """
    some = learned[1].any(axis=1) | (np.arange(len(learned[1])) % 10 == 0)
    known = samples(learned[0][some], learned[1][some])
    m, model = learned[1].shape[1], train(known, "all", NetworkConfig(feature="resistance"))
    ohms = samples(channels, np.zeros((len(channels), m))).resistance_ohm
    found, half = (of.mean(axis=(1, 2))[:, :m] for of in (model.forces(ohms), model.half_widths(ohms)[1]))
    return found, half


def trials(found: list[Pressed], kind: str) -> Iterator[tuple[str, Pressed, Pressed]]:
    """What is learned from and what is asked: contacts that were not learned from."""
    if kind == "spatial_resolution":
        x, wanted = found[0]
        place = np.unique(np.round(wanted[:, :2]), axis=0, return_inverse=True)[1]
        out = np.random.default_rng(0).permutation(place.max() + 1)[place] < HELD_OUT * place.max()
        yield "places not learned", (x[~out], wanted[~out]), (x[out], wanted[out])
        yield "another recording", found[0], found[1]
        return
    for k, tested in enumerate(found):
        rest = found[:k] + found[k + 1 :]
        x, wanted = (np.concatenate([one[part] for one in rest]) for part in (0, 1))
        yield f"recording {k + 1} by the others", (x, wanted), tested
    x, wanted = found[-1]
    n = int((1.0 - HELD_OUT) * len(x))
    yield "the last's last fifth by its first", (x[:n], wanted[:n]), (x[n:], wanted[n:])


def judged(folder: Path, kind: str) -> list[Row]:
    """A row of errors for each trial, in newtons or millimetres; of places, both coordinates together."""
    rows: list[Row] = []
    for name, learned, (channels, true) in trials(read_recordings(folder, kind), kind):
        m = min(true.shape[1], 2)
        got, half = decoded(learned, channels)
        error = (got - true)[:, :m]
        sizes = {"rmse": float(np.sqrt(np.mean(error**2))), "mean": float(np.abs(error).mean())}
        inside = {"within 95 % [%]": 100.0 * float(np.mean(np.abs(error) < half[:, :m]))}
        rows.append({"kind": kind, "tested on": name, "paper": PAPER[kind], **sizes, **inside})
    return rows
