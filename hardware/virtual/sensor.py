"""The sensor in a simulation of others: points and forces in, readings and decoded forces out. Loads torch.

Every tensor has the environments first: e sensors of one design live side by side, each with imperfections of its own.
"""

import logging
from collections.abc import Callable, Hashable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from pathlib import Path
from typing import TYPE_CHECKING, Any
from weakref import WeakKeyDictionary

import numpy as np
import torch
from torch import Tensor

from common.errors import ArgumentError, DesignError
from dataset.imperfections import OPEN_OHM, Imperfections, log_normal, of_both_ends
from dataset.measurement import SENSE_OHM
from dataset.resistance import conducted_lengths, exact_resistances, pillar_lengths
from dataset.simulation import require_conducted
from decoupler.data.columns import COMPONENTS, DEAD_OHM
from decoupler.inverse.sensor_model import SensorModel
from decoupler.model.at_strain import DecouplerAtStrain
from decoupler.model.decoder import Decoder
from decoupler.model.tensors import decoded_by, in_torch
from decoupler.model_file import read_model
from decoupler.readings import MIN_WHOLE_OHM
from decoupler.touch.presses import Grid
from decoupler.twin.twin_file import TwinFile, read_twin
from fem.array.solving import ResponseSettings, array_response
from fem.contact import Contact, Shape, Stepper, SurfaceCompliance, judge, surface_compliance
from geometry.design import SensorDesign, bent
from geometry.design_file import read_design
from geometry.layout import AXES, rest_lengths
from hardware.readout.crossbar import Corrector, Crossbar
from hardware.readout.crossbar_readout import seen_by
from hardware.readout.wrench import pad_positions
from hardware.virtual.rubber import RubberState
from hardware.virtual.steps import StrainedSensor, rounded, shares

if TYPE_CHECKING:
    from fem.array.response import ArrayResponse


JUDGED_STEPS = 16  #: of a contact, from one judgement of its error to the next
Pressing = tuple[Shape, Sequence[float], float | None]  #: shape, place [mm], normal force [N] or None


@dataclass(frozen=True, kw_only=True, eq=False)
class Reading:
    """One reading of e sensors; derivatives lead back to points and forces."""

    force_n: Tensor  #: (e, rows, cols, 3): on each pad along x, y, z [N]; Fz positive in compression
    resistance_ohm: Tensor  #: (e, rows, cols, P): of all pillars as the host finds them [Ω]; `OPEN_OHM` of dead ones
    decoded_n: Tensor | None  #: (e, rows, cols, k): forces that the model tells of these [N]; None without a model
    contacts: tuple[Contact, ...] = ()  #: of bodies, by `VirtualSensor.press`


class VirtualSensor:
    """Sensors of one design in a simulation of others, one an environment, all at once and differentiable.

    Contact forces at points go to the pads, by the array's response and eq. 1 (or conduction) into resistances; each
    specimen's gains, offsets and dead pillars, noise, crosstalk and converter make readings of these, and a trained
    model forces. Loads are quasi-static and the rubber linear, or, with a model of finite strain, as that has learned
    it; bodies press linear rubber. What its resistance remembers (`Memory`) is kept from reading to reading. Forces are
    those that act: they do not relax.

    Parameters
    ----------
    design : SensorDesign, TwinFile or path
        A design, its file, or the file of a twin: then each environment has a sensor of the twin's posterior.
    model : Decoder or path, optional
        Default: a twin's own decoder; of a design none, and nothing is decoded. A decoder of touch has no derivatives.
    environments : int
        Number e of sensors.
    noise : float
        Relative standard deviation of a measured resistance.
    bits : int, optional
        Bits of a converter behind a voltage divider, 4 to 24; default: exact readings. Leave it out with a crossbar.
    crossbar : Crossbar, optional
        Circuit that the array is read through, its crosstalk and converter included; default: each pillar alone.
    correct : bool
        False leaves the crossbar's crosstalk in.
    gain_spread : float
        Each pillar's resistance has a factor, uniform in 1 ± gain_spread.
    offset_ohm : float
        Standard deviation of what is added to each pillar's resistance [Ω].
    memory_spread, temperature_rise : float
        As of `dataset.Imperfections`: of a rubber with memory, relative; above that of the design's resistivity [K].
    dead_probability : float
        Of each pillar to be broken; it reads as open. A model that was not trained so takes that for forces.
    seed : int
        Of all that is drawn.
    dtype, device
        Of all tensors that it gives, whatever it takes; float32 is faster and errs by up to 0.01 N.
    response : ArrayResponse, optional
        Of the design; default: solved, or from the cache.

    Raises
    ------
    DesignError, ArgumentError
        If a setting makes no sense, or model, crossbar and design are not of one size or response.

    Examples
    --------
    The force that a finger must have pressed with, by the gradient of what one pillar shows:

    >>> from dataclasses import replace
    >>> from fem.array.closed_forms import layer_response
    >>> design = replace(SensorDesign(), array=replace(SensorDesign().array, rows=1, cols=2))
    >>> sensor = VirtualSensor(design, response=layer_response(design), bits=12)
    >>> force_n = torch.tensor([[[0.0, 0.0, 300.0]]], dtype=torch.float64, requires_grad=True)
    >>> reading = sensor.touch(torch.tensor([[[-7.5, 0.0]]]), force_n)
    >>> reading.resistance_ohm[0, 0, 0, 0].backward()  # the z pillar below
    >>> bool(force_n.grad[0, 0, 2] < 0)  # falls in compression
    True
    """

    def __init__(
        self,
        design: SensorDesign | TwinFile | Path | str,
        model: Decoder | Path | str | None = None,
        *,
        environments: int = 1,
        noise: float = 0.0,
        bits: int | None = None,
        crossbar: Crossbar | None = None,
        correct: bool = True,
        gain_spread: float = 0.0,
        offset_ohm: float = 0.0,
        memory_spread: float = 0.0,
        temperature_rise: float = 0.0,
        dead_probability: float = 0.0,
        seed: int = 0,
        dtype: torch.dtype = torch.float64,
        device: torch.device | str = "cpu",
        response: "ArrayResponse | None" = None,
    ) -> None:
        twin = design if isinstance(design, TwinFile) else None
        if isinstance(design, Path | str):
            twin = read_twin(Path(design))
            design = read_design(Path(design))
        design = design.design if isinstance(design, TwinFile) else design
        self.design = design if crossbar is None or twin is not None else seen_by(crossbar, design)
        self.shape = self.design.array.rows, self.design.array.cols  #: rows, cols
        self._layout = self.design.unit.layout
        self._pillars = (*self.shape, len(self._layout.pillars))
        self._imperfections = Imperfections(
            noise=noise,
            bits=bits,
            gain_spread=gain_spread,
            offset_ohm=offset_ohm,
            memory_spread=memory_spread,
            temperature_rise=temperature_rise,
            specimen=seed,
        )  # refuses what makes no sense
        if environments < 1 or not 0.0 <= dead_probability < 1.0:
            given = f"environments={environments}, dead_probability={dead_probability}"
            raise ArgumentError(f"{given} must be 1 or more and 0 to below 1.")
        if dtype not in (torch.float32, torch.float64):
            raise ArgumentError(f"dtype={dtype} must be torch.float32 or torch.float64.")
        if crossbar is not None and bits is not None:
            raise ArgumentError(f"bits={bits}: the crossbar has a converter of its own, say its bits there.")
        self.environments, self.dead_probability = environments, dead_probability
        self._like = torch.zeros((), dtype=dtype, device=device)
        self.dtype, self.device = self._like.dtype, self._like.device  #: of all tensors
        self._generator = torch.Generator(device=self._like.device).manual_seed(seed)
        decoder = twin.read_decoder() if twin is not None else None
        used: Decoder | None = read_model(Path(model)) if isinstance(model, Path | str) else model or decoder
        for name, other in (("model", used), ("crossbar", crossbar)):
            if other is not None and (other.rows, other.cols) != self.shape:
                sizes = f"{other.rows} × {other.cols} units, the design {self.shape[0]} × {self.shape[1]}"
                raise ArgumentError(f"the {name} has {sizes}: take one of this design.")
            if other is not None and other.layout != self._layout:
                raise ArgumentError(f"the {name} is of another layout than the design: take one of this design.")
        feels = used is not None and used.moments > 0
        self._followers = [used.follower() for _ in range(environments)] if feels and used is not None else None
        self._model: Any = used
        self._decoder: Any = None if used is None or feels else in_torch(used, self._like)
        self._crossbar = crossbar
        if crossbar is not None:  # the host knows of no shunts
            host = replace(crossbar, shunt_siemens=())
            self._found = Corrector(host).correct if correct else host.uncorrected
        self._twin: Any = None
        self._forward: Any
        if decoder is None and (strained := getattr(used, "posterior", None)) is not None:
            self._forward = self._shape = StrainedSensor(strained.forward, self._like)
        elif decoder is None:
            solved = self._designed(response)
            as_bodies = replace(solved, conducted=None)  # whose lengths are the pillars' own
            self._forward, self._shape = (
                in_torch(SensorModel.of(each, COMPONENTS["all"]), self._like) for each in (solved, as_bodies)
            )
        else:
            if gain_spread or offset_ohm:
                raise ArgumentError("gain_spread, offset_ohm: a twin has its own gains and offsets: leave them out.")
            known = decoder.forward
            if decoder.component.axes != AXES or known is None or not len(decoder.ensemble):
                told = ", ".join(decoder.component.forces)
                raise DesignError(f"this twin tells {told} alone: identify one of all forces.")
            self._twin = in_torch(decoder.ensemble, self._like)
            if isinstance(decoder, DecouplerAtStrain):
                self._forward = self._shape = StrainedSensor(known, self._like)
                self._readings = partial(self._forward.of_sensors, self._twin)
            else:
                self._forward = self._shape = in_torch(known, self._like)
                self._readings = partial(self._twin.readings, self._forward)
        self._gain = self._like.new_ones((environments, *self._pillars))
        self._offset = torch.zeros_like(self._gain)
        self.dead = torch.zeros_like(self._gain, dtype=torch.bool)  #: which pillars are broken, (e, rows, cols, P)
        self._member = torch.zeros(environments, dtype=torch.int64, device=self.device)
        self._steppers: list[dict[Hashable, Stepper]] = [{} for _ in range(environments)]
        self._judged, self._warned = WeakKeyDictionary[Stepper, int](), False
        self._rubber = RubberState(self.design, self._gain, memory_spread)
        self.reset()

    def _designed(self, response: "ArrayResponse | None") -> "ArrayResponse":
        if response is None:
            response, *_ = array_response(self.design, ResponseSettings())
        elif bent(response.design) != bent(self.design):
            raise ArgumentError("the response is of another design: leave it out, or give that of the design.")
        response = replace(response, design=self.design)
        require_conducted(response)
        return response

    @cached_property
    def _pads(self) -> tuple[Tensor, Tensor]:
        """Centres of the pads' columns along x, of their rows along y [mm]."""
        places = torch.as_tensor(pad_positions(self.design), dtype=self._like.dtype, device=self._like.device)
        return places[0, :, 0], places[:, 0, 1]

    def reset(self, which: Tensor | None = None, seed: int | None = None) -> None:
        """Draw gains, offsets and dead pillars anew; of a twin another sensor of its posterior. Rubber forgets.

        `which` are numbers of environments or a mask (e,), default: all; a `seed` starts all that is drawn from here on
        anew, noise included. An offset that outweighs a resistance is a DesignError.
        """
        if seed is not None:
            self._generator.manual_seed(seed)
        everywhere = torch.arange(self.environments, device=self._like.device)
        chosen = everywhere if which is None else everywhere[which]
        settings, like = self._imperfections, self._like.new_empty((len(chosen), *self._pillars))
        electrics = self.design.electrics
        self._gain[chosen] = 1.0 + settings.gain_spread * like.uniform_(-1.0, 1.0, generator=self._generator)
        self._offset[chosen] = settings.offset_ohm * like.normal_(generator=self._generator)
        self.dead = self.dead.index_copy(0, chosen, like.uniform_(generator=self._generator) < self.dead_probability)
        self._gain[chosen] = settings.warmed(self._gain[chosen], electrics)
        if electrics.contact_ohm and self._twin is None:
            drawn = self._normal((len(chosen), *self.shape, len(self._layout.terminals)))
            contacts = electrics.contact_ohm * of_both_ends(log_normal(drawn, electrics.contact_spread), self._layout)
            self._offset[chosen] += contacts - self._gain[chosen] * electrics.contacts_ohm
        self._rubber.forget(chosen, self._normal)
        if self._twin is not None:
            numbers = torch.empty(len(chosen), dtype=torch.int64, device=self.device)
            self._member[chosen] = numbers.random_(len(self._twin), generator=self._generator)
        at_rest = self._like.new_zeros((self.environments, *self.shape, len(AXES)))
        rest_ohm = self._gain * self.resistances(at_rest) + self._offset
        if bool((rest_ohm <= 0.0).any()):
            raise DesignError(
                f"offset_ohm={settings.offset_ohm:g} takes a pillar's resistance at rest to {float(rest_ohm.min()):.4g}"
                " Ω: lower it."
            )

    def pad_loads(self, points_mm: Tensor, force_n: Tensor) -> Tensor:
        """Forces on the pads from forces at points of the surface, as a stiff sheet on the pads would share them.

        Takes points (e, k, 2 or 3) [mm] in the sensor's frame (x along columns, y along rows, origin in the array's
        middle, z not looked at) and forces (e, k, 3) [N], Fz positive in compression; gives (e, rows, cols, 3). The
        four pads around a point share its force in proportion to nearness, so that total and moment are kept; the
        outermost take alone what is beyond their centres, nobody what is beyond the slab's edge.
        """
        e, k = points_mm.shape[:2]
        if points_mm.shape[-1] not in (2, 3) or force_n.shape != (e, k, 3) or e != self.environments:
            raise ArgumentError(
                f"points_mm has shape {tuple(points_mm.shape)}, force_n {tuple(force_n.shape)}: expected "
                f"({self.environments}, k, 2 or 3) and ({self.environments}, k, 3)."
            )
        (rows, cols), pitch_mm = self.shape, self.design.array.pitch_mm
        x, y = points_mm.to(self._like)[..., :2].unbind(dim=-1)
        on_slab = (x.abs() <= cols * pitch_mm / 2) & (y.abs() <= rows * pitch_mm / 2)
        by_col, by_row = (shares(place, centres) for place, centres in zip((x, y), self._pads, strict=True))
        return torch.einsum("ekr,ekc,eka->erca", by_row, by_col, force_n.to(self._like) * on_slab[..., None])

    def resistances(self, force_n: Tensor, seconds: float | None = None) -> Tensor:
        """Exact resistances (e, rows, cols, P) [Ω] under forces on the pads (e, rows, cols, 3) [N].

        A twin's are those of the environment's own sensor, gains and offsets included. With `seconds` since these were
        asked for last, rubber with memory remembers; without, resistances are those of rubber that does not.
        """
        force_n = self._own(force_n, "force_n", len(AXES))
        columns = force_n.reshape(self.environments, -1)
        if self._twin is not None:
            ohms = self._readings(columns, self._member).reshape(self._gain.shape)
        else:
            ohms = self._forward.resistances(columns).reshape(self._gain.shape)
        return self._remembered(ohms, lambda: self._shape.lengths(columns).reshape(self._gain.shape), seconds)

    def _remembered(self, ohms: Tensor, lengths_mm: Callable[[], Tensor], seconds: float | None) -> Tensor:
        """Resistances of pillars of these lengths that were read so many seconds ago; contacts do not remember."""
        if seconds is None or not self._rubber.remembers:
            return ohms
        contacts_ohm = self.design.electrics.contacts_ohm
        return contacts_ohm + self._rubber.step(lengths_mm(), seconds) * (ohms - contacts_ohm)

    def strains(self, force_n: Tensor) -> Tensor:
        """Largest strain |l − l₀|/l₀ of any pillar, (e,); beyond 0.3 the linear model is not to be trusted."""
        columns = self._own(force_n, "force_n", len(AXES)).reshape(self.environments, -1)
        lengths = self._shape.lengths(columns).reshape(-1, *self._pillars)
        return (lengths / self._like.new_tensor(rest_lengths(self.design.unit)) - 1.0).abs().amax(dim=(1, 2, 3))

    def read(self, resistance_ohm: Tensor) -> Tensor:
        """Resistances as this specimen shows them and its electronics read them, both (e, rows, cols, P) [Ω].

        Order as of `Imperfections.apply`: gain and offset, noise, converter, and last what is dead reads as open.
        A converter's counts have the derivatives of what they round; outside its range they stay at its end.
        """
        resistance_ohm = self._own(resistance_ohm, "resistance_ohm", self._pillars[-1])
        settings = self._imperfections
        ohms = (self._gain * resistance_ohm + self._offset).clamp(min=MIN_WHOLE_OHM)
        if settings.noise:
            ohms = ohms * (1.0 + settings.noise * self._normal(ohms.shape))
        if (crossbar := self._crossbar) is not None:
            readings = crossbar.readings(torch.where(self.dead, OPEN_OHM, ohms))
            if crossbar.noise:
                readings = readings + crossbar.noise * self._normal(readings.shape)
            ohms = self._found(readings if crossbar.bits is None else rounded(readings, crossbar.bits))
        elif settings.bits is not None:
            ohms = SENSE_OHM * (1.0 / rounded(SENSE_OHM / (ohms + SENSE_OHM), settings.bits) - 1.0)
        return torch.where(self.dead, OPEN_OHM, ohms)

    def forces(self, resistance_ohm: Tensor) -> Tensor:
        """Forces (e, rows, cols, k) [N] that the model tells of resistances (e, rows, cols, P) [Ω].

        Readings that no strain explains are left out, as `Decoder.without` does.
        """
        if self._decoder is None:
            raise ArgumentError("this sensor has no model to decode with: give VirtualSensor one.")
        resistance_ohm = self._own(resistance_ohm, "resistance_ohm", self._pillars[-1])
        readable = torch.as_tensor(self._decoder.readable, device=self.device)
        columns = torch.where(readable, resistance_ohm.flatten(1)[:, self._decoder.places], DEAD_OHM)
        decoded = self._like.new_empty((self.environments, len(self._decoder.output_scaling.centre)))
        for which, decoder in self._model.sifted(resistance_ohm.detach().cpu().double().numpy()):
            rows = torch.as_tensor(which, device=self.device)
            decoded = decoded.index_copy(0, rows, decoded_by(decoder, self._decoder, columns[rows]))
        return decoded.reshape(self.environments, *self.shape, -1)

    def touch(self, points_mm: Tensor, force_n: Tensor, seconds: float | None = None) -> Reading:
        """All of it: forces at points (e, k, 2 or 3) and (e, k, 3) to one reading; arguments as of `pad_loads`.

        Rubber with memory needs the `seconds` since the last reading; they are an `ArgumentError` if missing.
        """
        self._rubber.require(seconds)
        applied_n = self.pad_loads(points_mm, force_n)
        resistance_ohm = self.read(self.resistances(applied_n, seconds))
        return Reading(force_n=applied_n, resistance_ohm=resistance_ohm, decoded_n=self._decoded(resistance_ohm))

    def press(
        self, bodies: Sequence[Mapping[Hashable, "Pressing"]], friction: float = 0.5, seconds: float | None = None
    ) -> Reading:
        """Bodies pressed into rubber or plates to one reading, without derivatives; each goes on from where it was.

        Parameters
        ----------
        bodies : sequence of mappings
            Of each environment: by a name that stays, a shape as it stands, the place x, y, z of its origin from the
            array's middle and above the undeformed top [mm], and the normal force [N], or None: as its z says. What is
            not named any more has gone.
        friction : float
            Coulomb's coefficient.
        seconds : float, optional
            Since the last reading, as of `touch`.

        Returns
        -------
        Reading
            Forces are those on each unit's share of the top; with the contacts, environment by environment. Bodies do
            not feel each other through the rubber.

        Raises
        ------
        ArgumentError, DesignError, ContactError
            If environments are not as many, the sensor is a twin, and as `surface_compliance`, `Stepper.step` and
            `fem.contact.judge`.
        """
        if len(bodies) != self.environments:
            raise ArgumentError(f"bodies are of {len(bodies)} environments, expected {self.environments}.")
        if self._twin is not None:
            raise ArgumentError("a twin's own sensors know loads on pads alone: press a design, with gain_spread.")
        self._rubber.require(seconds)
        surface, grid = self._top
        n_upper, n_units = len(self._layout.upper), surface.design.n_units
        force, moved = (np.zeros((self.environments, n_units, k, 3)) for k in (1, n_upper))
        tiled_n = np.zeros((self.environments, *surface.on_tiles.shape[:3]), np.float32)
        contacts: list[Contact] = []
        for number, own in enumerate(bodies):
            before = self._steppers[number]
            steppers = {name: before.get(name) or Stepper(surface, friction=friction) for name in own}
            self._steppers[number] = steppers
            for name, (shape, place_mm, normal_n) in own.items():
                if (contact := steppers[name].step(shape, place_mm, normal_n)) is not None:
                    self._judge(contact, steppers[name])
                    contacts.append(contact)
                    force[number, :, 0] += contact.force_n.reshape(-1, 3)
                    if grid is None:
                        moved[number] += contact.electrode_mm.reshape(-1, n_upper, 3)
                        tiled_n[number] += contact.tile_force_n
                    else:
                        box_mm = np.array([*contact.patch.low_mm, *contact.patch.high_mm])
                        moved[number] += grid.pressed_mm(box_mm, contact.cell_force_n).reshape(-1, n_upper, 3)
        lengths, sizes = pillar_lengths(moved, self.design.unit), self._gain.shape
        effective = lengths if surface.conducted is None else conducted_lengths(surface.conducted, tiled_n)
        with torch.no_grad():
            exact_ohm = self._like.new_tensor(exact_resistances(effective, self.design)).reshape(sizes)
            exact_ohm = self._remembered(exact_ohm, lambda: self._like.new_tensor(lengths).reshape(sizes), seconds)
            resistance_ohm = self.read(exact_ohm)
            decoded_n = self._decoded(resistance_ohm)
        applied_n = self._like.new_tensor(force).reshape(self.environments, *self.shape, len(AXES))
        return Reading(force_n=applied_n, resistance_ohm=resistance_ohm, decoded_n=decoded_n, contacts=tuple(contacts))

    def _judge(self, contact: Contact, stepper: Stepper) -> None:
        """Refuse a contact whose compliance errs too much, at its begin and now and then; a warning is said once."""
        steps = self._judged.get(stepper, 0)
        self._judged[stepper] = steps + 1
        if steps % JUDGED_STEPS == 0 and (warning := judge(contact, on_grid=False)) and not self._warned:
            self._warned = True
            logging.getLogger("tripillar").warning("of a contact %s", warning)

    def _decoded(self, resistance_ohm: Tensor) -> Tensor | None:
        if self._followers is None:
            return None if self._decoder is None else self.forces(resistance_ohm)
        ohms = resistance_ohm.detach().cpu().double().numpy()
        found = [one.touches(scan)[0].force_n for one, scan in zip(self._followers, ohms[:, None], strict=True)]
        return self._like.new_tensor(np.stack(found)).reshape(*resistance_ohm.shape[:-1], -1)

    @cached_property
    def _top(self) -> tuple[SurfaceCompliance, Grid | None]:
        """The top, and of one bare rubber its grid: plates, and tops of pillars, tell their electrodes at once."""
        surface, *_ = surface_compliance(self.design)
        return surface, None if surface.has_plates or surface.has_tops else Grid.of(surface)

    def _normal(self, shape: tuple[int, ...]) -> Tensor:
        return self._like.new_empty(shape).normal_(generator=self._generator)

    def _own(self, values: Tensor, name: str, last: int) -> Tensor:
        expected = (self.environments, *self.shape, last)
        if values.shape != expected:
            raise ArgumentError(f"{name} has shape {tuple(values.shape)}, expected {expected}.")
        return values.to(self._like)
