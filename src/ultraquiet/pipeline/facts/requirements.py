"""What a study asked of its law and what came of it: one frozen dataclass a requirement."""

from ultraquiet.pipeline.facts.typed import fact


@fact
class RequirementFacts:
    """One requirement at one place: a unit of the bench, or an end of the design model; `figure` None: not measured."""

    requirement: str
    where: str
    asked: float
    figure: float | None
    met: bool
    sentence: str


@fact
class RequirementsFacts:
    """What was asked of the law, judged on every unit; the band's worst direction is over `band_hz`."""

    law: str
    band_hz: tuple[float, float]
    judged: tuple[RequirementFacts, ...]

    @property
    def missed(self) -> tuple[str, ...]:
        """One sentence for each requirement that is not met."""
        return tuple(each.sentence for each in self.judged if not each.met)

    @property
    def ok(self) -> bool:
        """True when every requirement is met."""
        return not self.missed
