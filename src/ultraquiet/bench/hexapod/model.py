"""A unit put together once: benches of the same unit share its matrices."""

from functools import cached_property, lru_cache

from ultraquiet._base.constraints import ComplexArray, FloatArray
from ultraquiet.bench.hexapod.chain import Chain, ModalBasis, chain, sampled_response
from ultraquiet.bench.hexapod.physics.assemble import Mechanics, assemble
from ultraquiet.bench.hexapod.physics.drift import REFERENCE_C, at_temperature
from ultraquiet.bench.hexapod.physics.parameters import GEOPHONE_HZ, RATE_HZ
from ultraquiet.bench.hexapod.physics.parts import HexapodParts, nominal
from ultraquiet.bench.hexapod.physics.spread import draw
from ultraquiet.linalg.balance import Coordinates, modal

UNITS_KEPT = 128  # a campaign of a hundred units is put together once
Sampled = tuple[FloatArray, FloatArray, FloatArray]


class Model:
    """The linear truth of one unit, at any temperature; treat its arrays as read-only."""

    def __init__(self, parts: HexapodParts) -> None:
        self.parts = parts

    @cached_property
    def mechanics(self) -> Mechanics:
        """Bodies, struts and mounts at the reference temperature."""
        return assemble(self.parts)

    @cached_property
    def basis(self) -> ModalBasis:
        """The shapes in which motions are expressed, at every temperature."""
        return ModalBasis.of(self.mechanics, self.parts)

    @cached_property
    def continuous(self) -> Chain:
        """The chain in continuous time at the reference temperature."""
        return chain(self.mechanics, self.parts, self.basis)

    @cached_property
    def sampled(self) -> Sampled:
        """A, B, C of the exact zero-order-hold equivalent at the reference temperature."""
        return self.continuous.sampled(RATE_HZ)

    def sampled_at(self, temperature_c: float) -> Sampled:
        """Return A, B, C at a temperature, in the same states."""
        if temperature_c == REFERENCE_C:
            return self.sampled
        parts = at_temperature(self.parts, temperature_c)
        return chain(assemble(parts), parts, self.basis).sampled(RATE_HZ)

    @cached_property
    def _blocks(self) -> Coordinates:
        return modal(*self.sampled)

    def stepped_at(self, temperature_c: float) -> Sampled:
        """Return A, B, C at a temperature, in the states in which A is block-diagonal at the reference temperature.

        A step then costs some thirty times less than with a full A.
        """
        blocks = self._blocks
        if temperature_c == REFERENCE_C:
            return blocks[:3]
        A, B, C = self.sampled_at(temperature_c)
        return blocks.inverse @ A @ blocks.T, blocks.inverse @ B, C @ blocks.T

    def response(self, f_hz: FloatArray, temperature_c: float) -> ComplexArray:
        """Return the response between samples `(ny, nu, nf)`, from complex stiffnesses, hold and images."""
        parts = at_temperature(self.parts, temperature_c)
        return sampled_response(assemble(parts), parts, f_hz)


@lru_cache(maxsize=UNITS_KEPT)
def built(unit: str, instruments: str, spread: float, unit_seed: int, geophone_hz: float = GEOPHONE_HZ) -> Model:
    """Return the model of a unit, put together once."""
    return Model(draw(nominal(unit, instruments, geophone_hz), spread, unit_seed))
