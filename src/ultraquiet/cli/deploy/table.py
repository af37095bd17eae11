"""The one table of `ultraquiet deploy`: the law, its cost, what proved it, what became of the loop."""

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from ultraquiet.deploy import Deployment, Verification

NONE = "none"


def requested_targets(names: list[str] | None) -> tuple[str, ...]:
    """Return the targets that were asked for, known ones; all of them by default."""
    from ultraquiet.deploy.toolchain.targets import TARGETS, target_named

    if names is None:
        return tuple(TARGETS)
    return tuple(target_named(name).name for name in names if name != NONE)


def rows(deployment: "Deployment", proof: "Verification", c31: bool) -> list[tuple[str, str]]:
    """Return what and value of every line; what a TMS320C31 would take only where somebody asks for it."""
    from ultraquiet.deploy.figures import said

    listed = said({key: v for key, v in deployment.tables.items() if c31 or not key.startswith("c31_")})
    if proof.compiler is not None:
        listed.append(("compared here", f"{proof.steps} steps, compiled by {proof.compiler}, {proof.seconds:.1f} s"))
    listed.extend(on_targets(proof))
    if proof.fuzz is not None:
        listed.append(
            ("random bits", f"{proof.fuzz.steps} steps under sanitizers: {proof.fuzz.finding or 'nothing found'}")
        )
    listed.extend(("did not run", sentence) for sentence in proof.missing)
    if proof.loop is not None:
        listed.extend((f"loop: {what}", f"{one} as designed, {two} rounded") for what, one, two in proof.loop.rows())
    return listed


def on_targets(proof: "Verification") -> list[tuple[str, str]]:
    """Return the lines of the emulated processors."""
    listed = []
    for each in proof.targets:
        calm = "" if each.calm is None else f"; at full command inside the limits {each.calm[0]} to {each.calm[1]}"
        size = f"; {each.flash_bytes} bytes of flash, {each.stack_bytes} of stack"
        listed.append((f"on {each.target.title}", f"{each}{calm}{size}"))
    return listed
