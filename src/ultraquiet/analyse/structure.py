"""What is known of a perturbation: the blocks on its diagonal."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from ultraquiet._base.constraints import FloatArray, one_of, whole
from ultraquiet._base.errors import InputError

KINDS = ("full", "repeated", "real")


@dataclass(frozen=True)
class PerturbationBlock:
    """One block of a perturbation, which feeds outputs of M back to its inputs.

    Args:
        outputs: how many outputs of M the block takes.
        inputs: how many inputs of M it drives; as many as outputs when absent.
        kind: `full`, any complex matrix; `repeated`, one complex number on a diagonal; `real`, one real number there.

    Raises:
        InputError: sizes below one, a repeated block that is not square.

    >>> PerturbationBlock(2).inputs, PerturbationBlock(1, kind="real").kind
    (2, 'real')
    """

    outputs: int
    inputs: int = 0
    kind: str = "full"

    def __post_init__(self) -> None:
        whole("PerturbationBlock", "outputs", self.outputs, 1)
        object.__setattr__(self, "inputs", whole("PerturbationBlock", "inputs", self.inputs or self.outputs, 1))
        one_of("PerturbationBlock", "kind", self.kind, KINDS)
        if self.kind != "full" and self.inputs != self.outputs:
            raise InputError(
                f"PerturbationBlock: a {self.kind} block must be square, got {self.outputs} outputs and"
                f" {self.inputs} inputs."
            )


@dataclass(frozen=True)
class BlockStructure:
    """All blocks, in the order of the channels."""

    blocks: tuple[PerturbationBlock, ...]

    @property
    def outputs(self) -> list[slice]:
        """Place of each block among the outputs of M."""
        return _places([b.outputs for b in self.blocks])

    @property
    def inputs(self) -> list[slice]:
        """Place of each block among the inputs of M."""
        return _places([b.inputs for b in self.blocks])

    @property
    def shape(self) -> tuple[int, int]:
        """Outputs and inputs of M."""
        return sum(b.outputs for b in self.blocks), sum(b.inputs for b in self.blocks)

    @property
    def has_real(self) -> bool:
        """Whether a block is real."""
        return any(b.kind == "real" for b in self.blocks)

    def members(self) -> tuple[FloatArray, FloatArray]:
        """Return which outputs, and which inputs, belong to which block: `(nz, blocks)`, `(nw, blocks)` of 0 and 1."""
        nz, nw = self.shape
        out, into = np.zeros((nz, len(self.blocks))), np.zeros((nw, len(self.blocks)))
        for k, (z, w) in enumerate(zip(self.outputs, self.inputs, strict=True)):
            out[z, k] = into[w, k] = 1.0
        return out, into


def structure(
    who: str, blocks: Sequence[int | tuple[int, int] | PerturbationBlock] | None, shape: tuple[int, int]
) -> BlockStructure:
    """Return the structure that `blocks` describes, one complex number a channel when absent; refuse what misfits M.

    Args:
        who: asks.
        blocks: a number k is a full complex k x k block, a pair a full one of (outputs, inputs) of M.
        shape: of M.
    """
    if blocks is None:
        blocks = [1] * shape[0]
    if isinstance(blocks, str | bytes) or not isinstance(blocks, Sequence) or not len(blocks):
        raise InputError(f"{who}: 'blocks' must be a list of sizes, pairs or PerturbationBlock, got {blocks!r}.")
    block_structure = BlockStructure(tuple(_block(who, b) for b in blocks))
    if block_structure.shape != tuple(shape):
        raise InputError(
            f"{who}: the blocks take {block_structure.shape[0]} outputs and drive {block_structure.shape[1]} inputs, "
            f"M has {shape[0]} outputs and {shape[1]} inputs."
        )
    return block_structure


def _block(who: str, block: int | tuple[int, int] | PerturbationBlock) -> PerturbationBlock:
    if isinstance(block, PerturbationBlock):
        return block
    if isinstance(block, tuple | list) and len(block) == 2:
        return PerturbationBlock(whole(who, "blocks", block[0], 1), whole(who, "blocks", block[1], 1))
    return PerturbationBlock(whole(who, "blocks", block, 1))


def _places(sizes: list[int]) -> list[slice]:
    ends = np.cumsum([0, *sizes])
    return [slice(int(low), int(high)) for low, high in pairwise(ends)]
