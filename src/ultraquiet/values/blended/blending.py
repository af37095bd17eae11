"""Sensors and actuators blended to modes, and everything seen through them."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from ultraquiet._base.constraints import FloatArray, frozen, real_array
from ultraquiet._base.errors import InputError
from ultraquiet._base.provenance import Provenance, content_hash
from ultraquiet._base.shown.line import counted
from ultraquiet.values.blended.matrices import actuator_matrix, blend, rank, row_sizes, sensor_matrix
from ultraquiet.values.blended.wires import command_limits, modes_of, reading_limits
from ultraquiet.values.channel import Channel, channels
from ultraquiet.values.frequency_response import FrequencyResponse
from ultraquiet.values.record import Record
from ultraquiet.values.state_space import StateSpace

# Share of a record's command power that no mode explains, beyond which it was not driven through these modes.
BESIDE = 1e-12
# Of each actuator's loudest command, less of what a mode adds to it is rounding.
ROUNDING = 1e-12


@dataclass(frozen=True, init=False, eq=False)
class Blending:
    """q = Ts y and u = Ta v: a controller sees modes q and gives modes v, the bench has readings y and commands u.

    The plant in modes is Ts G Ta, and a law v = K q designed for it is u = Ta K Ts y on the bench: exactly the same
    loop.

    Args:
        sensor_matrix: Ts `(modes, sensors)`, in the mode's unit per the sensor's unit; full row rank.
        actuator_matrix: Ta `(actuators, modes)`; full column rank.
        sensors, actuators: channels or names of the bench.
        sensor_modes, actuator_modes: channels or names of the modes; numbered when absent. A name alone has the unit of
            what it is blended from; where that is mixed, a `Channel` must say the unit, and `.sentences` says so.
            Limits are those of the bench (`command_limits`: any commands within those of the modes stay within the
            actuators'), narrower where the channel says so.

    Raises:
        InputError: shapes that do not fit, modes that follow from each other, mixed units without a word.

    >>> pair = Blending([[0.5, 0.5]], [[1.0]], ["left", "right"], ["shaker"], ["heave"])
    >>> law = pair.law(StateSpace([[0.5]], [[1.0]], [[1.0]], [[-2.0]], 100.0))
    >>> law.D.tolist(), [c.name for c in law.actuators]
    ([[-1.0, -1.0]], ['left', 'right'])
    """

    sensor_matrix: FloatArray
    actuator_matrix: FloatArray
    sensors: tuple[Channel, ...]
    actuators: tuple[Channel, ...]
    sensor_modes: tuple[Channel, ...]
    actuator_modes: tuple[Channel, ...]
    sentences: tuple[str, ...] = field(default=())

    def __init__(
        self,
        sensor_matrix: ArrayLike,
        actuator_matrix: ArrayLike,
        sensors: Sequence[Channel | str],
        actuators: Sequence[Channel | str],
        sensor_modes: Sequence[Channel | str] | None = None,
        actuator_modes: Sequence[Channel | str] | None = None,
    ) -> None:
        Ts, Ta = (
            real_array("Blending", n, m, 2)
            for n, m in (("sensor_matrix", sensor_matrix), ("actuator_matrix", actuator_matrix))
        )
        wires_y, wires_u = (
            channels("Blending", wires, len(wires), kind) for wires, kind in ((sensors, "sensor"), (actuators, "input"))
        )
        _fits("sensor_matrix", "(modes, sensors)", Ts, (Ts.shape[0], len(wires_y)), rank(Ts))
        _fits("actuator_matrix", "(actuators, modes)", Ta, (len(wires_u), Ta.shape[1]), rank(Ta))
        modes_y, mixed_y = modes_of(Ts, wires_y, sensor_modes, "sensor mode")
        modes_u, mixed_u = modes_of(Ta.T, wires_u, actuator_modes, "actuator mode")
        put = object.__setattr__
        put(self, "sensor_matrix", frozen(Ts))
        put(self, "actuator_matrix", frozen(Ta))
        put(self, "sensors", wires_y)
        put(self, "actuators", wires_u)
        put(self, "sensor_modes", reading_limits(Ts, wires_y, modes_y))
        put(self, "actuator_modes", command_limits(Ta, wires_u, modes_u))
        put(self, "sentences", (*mixed_y, *mixed_u))

    @property
    def hash(self) -> str:
        """Content hash of matrices and channels."""
        wires = (self.sensors, self.actuators, self.sensor_modes, self.actuator_modes)
        return content_hash(self.sensor_matrix, self.actuator_matrix, *(list(w) for w in wires))

    def law(self, law: StateSpace) -> StateSpace:
        """Return u = Ta K Ts y of a law v = K q: the same states, the bench's wires."""
        my, mu = len(self.sensor_modes), len(self.actuator_modes)
        if law.D.shape != (mu, my):
            raise InputError(
                f"Blending.law: a law from {my} to {mu} modes is needed, got one from {law.D.shape[1]} to "
                f"{law.D.shape[0]}."
            )
        Ts, Ta = self.sensor_matrix, self.actuator_matrix
        # A law's inputs are the bench's sensors.
        wires = self.sensors, self.actuators
        return StateSpace(law.A, law.B @ Ts, Ta @ law.C, Ta @ law.D @ Ts, law.rate_hz, *wires, law.provenance)

    def plant(self, plant: StateSpace) -> StateSpace:
        """Return Ts G Ta of a plant G `(sensors, actuators)`."""
        self.check("plant", plant.actuators, plant.sensors)
        Ts, Ta = self.sensor_matrix, self.actuator_matrix
        wires = self.actuator_modes, self.sensor_modes
        return StateSpace(plant.A, plant.B @ Ta, Ts @ plant.C, Ts @ plant.D @ Ta, plant.rate_hz, *wires)

    def response(self, response: FrequencyResponse) -> FrequencyResponse:
        """Return Ts G Ta at every frequency; coherence and variance are of single channels and do not go along."""
        self.check("response", response.actuators, response.sensors)
        values = np.einsum("ij,jkf,kl->ilf", self.sensor_matrix, response.values, self.actuator_matrix)
        wires = self.actuator_modes, self.sensor_modes
        return FrequencyResponse(response.f_hz, values, None, response.estimator, *wires, self._made("response"))

    def record(self, record: Record) -> Record:
        """Return modes of a record of the bench: q = Ts y, and the v of which the commands are u = Ta v.

        Raises:
            InputError: other channels, or commands that no v explains; the bench must be driven through the modes.
        """
        self.check("record", record.actuators, record.sensors)
        v = self._at_rest(self.commands(record.inputs), record.inputs)
        # Judged with every actuator in the units of its own loudest command, so that no unit hides another.
        loudest = np.abs(record.inputs).max(axis=1, keepdims=True)
        miss = (record.inputs - blend(self.actuator_matrix, v)) / np.where(loudest > 0, loudest, 1.0)
        share = float(np.mean(miss**2))
        if share > BESIDE:
            worst = self.actuators[int(np.argmax(np.mean(miss**2, axis=1)))].name
            raise InputError(
                f"Blending.record: {share:.2g} of the commands' power is in no mode (actuator '{worst}' most); drive "
                f"the bench through the {counted(len(self.actuator_modes), 'mode')}, within their limits."
            )
        wires = self.actuator_modes, self.sensor_modes
        made = self._made("record", record.hash)
        return Record(v, blend(self.sensor_matrix, record.outputs), record.rate_hz, *wires, made)

    def commands(self, commands: FloatArray) -> FloatArray:
        """Return the modes v `(modes, n)` nearest to commands u `(actuators, n)`; exact where u = Ta v."""
        return blend(self._inverse, commands)

    def _at_rest(self, v: FloatArray, u: FloatArray) -> FloatArray:
        """Return modes with zeros where one adds but rounding to every actuator: a mode at rest does not move."""
        part = np.abs(self.actuator_matrix) / np.where(loud := np.abs(u).max(axis=1), loud, np.inf)[:, None]
        return np.where(part.max(axis=0)[:, None] * np.abs(v) > ROUNDING, v, 0.0)

    @cached_property
    def _inverse(self) -> FloatArray:
        """Ta^+ `(modes, actuators)`, every actuator counted by its own share so that no unit hides another."""
        return sensor_matrix(self.actuator_matrix, noise=row_sizes(self.actuator_matrix))

    def noise(self, covariance: ArrayLike) -> FloatArray:
        """Return Ts R Ts', the covariance of the modes' noise, from that of the sensors `(sensors, sensors)`."""
        R = real_array("Blending.noise", "covariance", covariance, 2)
        if R.shape != (len(self.sensors),) * 2:
            raise InputError(f"Blending.noise: 'covariance' must be square over {len(self.sensors)} sensors.")
        return self.sensor_matrix @ R @ self.sensor_matrix.T

    def without(self, sensors: Sequence[str] = (), actuators: Sequence[str] = ()) -> "Blending":
        """Return the blending of the same modes without the sensors and actuators named, their wires kept.

        The mode shapes behind the matrices, H = Ts^+ and Ta^+, lose the rows of what is left out and are inverted
        anew by least squares; what is left out has zeros in Ts and Ta. Channels of several units count by their
        share in the matrix, so that no unit weighs more.

        Raises:
            InputError: a name that is not there; too few channels left to tell the modes apart or to drive them.
        """
        dead_y, dead_u = _places("sensor", sensors, self.sensors), _places("actuator", actuators, self.actuators)
        Ts, Ta = self.sensor_matrix, self.actuator_matrix
        if dead_y:
            noise = None if _one_unit(self.sensors) else 1.0 / row_sizes(Ts.T)
            Ts = sensor_matrix(actuator_matrix(Ts.T, effort=noise), noise, dead_y)
        if dead_u:
            effort = None if _one_unit(self.actuators) else row_sizes(Ta)
            Ta = actuator_matrix(sensor_matrix(Ta, noise=effort).T, effort, dead_u)
        # What readings can reach follows from the new matrix; limits of commands only become narrower.
        modes = [Channel(c.name, c.unit) for c in self.sensor_modes]
        return Blending(Ts, Ta, self.sensors, self.actuators, modes, self.actuator_modes)

    def check(self, who: str, actuators: Sequence[Channel], sensors: Sequence[Channel]) -> None:
        """Refuse channels of another number, or of these names in another order."""
        for kind, mine, given in (("actuator", self.actuators, actuators), ("sensor", self.sensors, sensors)):
            names, others = [c.name for c in mine], [c.name for c in given]
            if len(names) != len(others):
                raise InputError(f"Blending.{who}: it blends {len(names)} {kind}s, got {len(others)}.")
            if names != others and sorted(names) == sorted(others):
                order = ", ".join(others)
                raise InputError(f"Blending.{who}: the {kind}s are in another order, {order}; reorder them.")

    def _made(self, verb: str, *parents: str) -> Provenance:
        return Provenance(f"blending.{verb}", {"blending": self.hash}, parents=parents)


def _one_unit(wires: Sequence[Channel]) -> bool:
    return len({c.unit for c in wires}) == 1


def _places(kind: str, names: Sequence[str], wires: Sequence[Channel]) -> list[int]:
    known = [c.name for c in wires]
    for name in names:
        if name not in known:
            raise InputError(f"Blending.without: there is no {kind} '{name}'; known are {', '.join(known)}.")
    return [known.index(name) for name in names]


def _fits(name: str, what: str, matrix: FloatArray, shape: tuple[int, int], found: int) -> None:
    modes = matrix.shape[0 if name == "sensor_matrix" else 1]
    if matrix.shape != shape or 0 in matrix.shape:
        raise InputError(f"Blending: '{name}' must be {what}, {shape} here, got {matrix.shape}.")
    if found < modes:
        raise InputError(
            f"Blending: '{name}' of {modes} modes has rank {found}: some modes follow from others; leave them out."
        )
