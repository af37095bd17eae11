"""A generated folder: its law in control, its proof, its documents."""

from collections.abc import Callable, Sequence
from dataclasses import asdict
from functools import cached_property
from pathlib import Path
from typing import Any

from ultraquiet._base.constraints import whole
from ultraquiet._base.shown import Shown
from ultraquiet.bench import Bench
from ultraquiet.deploy.c31 import cycles
from ultraquiet.deploy.c_code import render
from ultraquiet.deploy.c_code.compiled import CompiledController, Library
from ultraquiet.deploy.c_code.output_folder import MANIFEST, manifest_text, rewrite
from ultraquiet.deploy.c_code.plan import CodePlan, GeneratedCode
from ultraquiet.deploy.law.coefficients import CoefficientBank, bank_for
from ultraquiet.deploy.law.coordinates import balanced
from ultraquiet.deploy.law.law import require_discrete, require_plant
from ultraquiet.deploy.law.twin import Twin
from ultraquiet.deploy.law.word_length import WordFormat, float_formats
from ultraquiet.deploy.toolchain import compiler
from ultraquiet.deploy.toolchain.targets import TARGETS
from ultraquiet.deploy.verification.bench_tones import on_bench
from ultraquiet.deploy.verification.fuzz import STEPS as FUZZ_STEPS
from ultraquiet.deploy.verification.rounded_loop import reanalysis
from ultraquiet.deploy.verification.verify import MOST_STEPS, STEPS, Verification, verify_code
from ultraquiet.values.controller import Controller
from ultraquiet.values.state_space import StateSpace
from ultraquiet.values.status import Status, StatusWord


class Deployment(GeneratedCode, Shown):
    """A generated folder and what is known of it.

    `tables` holds `states`, `form`, `c31_cycles` (kernel and frame), `c31_budget`, `flash_bytes`, `ram_bytes`,
    `cortex_m7_instructions` (None unless counted), `bit_exact` (None until `verify` has compared) and more; `status`
    is a sentence on the law, `law` holds the rounded coefficients, `designed` and `plant` what it was made from, evenly
    scaled, `given` the law in the coordinates it came in.
    """

    def __init__(
        self,
        plan: CodePlan,
        folder: Path,
        tables: dict[str, Any],
        status: Status,
        designed: StateSpace | None = None,
        plant: StateSpace | None = None,
        given: StateSpace | None = None,
    ) -> None:
        super().__init__(plan, folder)
        self.tables, self.status, self.designed, self.plant = tables, status, designed, plant
        self.given = given
        self._library: Library | None = None

    @property
    def quantised(self) -> StateSpace:
        """The linear law with its rounded coefficients, for an analysis in float64."""
        return self.law.state_space()

    @property
    def word_formats(self) -> tuple[WordFormat, ...]:
        """How many bits the code keeps of each quantity."""
        return float_formats(self.law)

    @cached_property
    def controller(self) -> Controller:
        """The law in control, from rest; the compiled code runs it (without a compiler its twin)."""
        return self.instance()

    def instance(self, ramp: bool = False) -> Controller:
        """Return a new `Controller` that runs the compiled code; `ramp` starts it as a real start would."""
        cc = compiler.compiler()
        if self._library is None and cc is not None:
            self._library = Library(self.law, self.folder, cc)
        if self._library is not None:
            return CompiledController(self._library, ramp)
        twin = Twin(self.law)
        if ramp:
            twin.enable()
        else:
            twin.reset()
        return twin

    def verify(
        self,
        steps: int = STEPS,
        seed: int = 0,
        *,
        plant: StateSpace | None = None,
        bench: Bench | Callable[[], Bench] | None = None,
        targets: Sequence[str] | None = None,
        fuzz_steps: int = FUZZ_STEPS,
        tones_hz: Sequence[float] | None = None,
    ) -> Verification:
        """Compile the code, compare `steps` samples and the self-test bit by bit, and note the outcome.

        With an ARM compiler and an emulator at hand both also run on the `targets`, `cortex-m7` among them, where
        each step's instructions are counted. `tables` and the folder's README and manifest then hold what was found.
        Never raises for a missing or refusing compiler: the status says so.

        Args:
            steps: samples to compare (at most 100 000 on each target).
            seed: of the measurements.
            plant: G, for the loop with the rounded law to be analysed again; else the one given to `generate`.
            bench: a bench, or a function that makes one, on which float64 law and compiled code reduce tones.
            targets: emulated processors; empty for none, all known ones when absent.
            fuzz_steps: random steps under the compiler's sanitizers; 0 for none.
            tones_hz: where attenuation is compared, Hz; the ends and the middle of the plant's own band when absent, of
                the law's where there is no plant.
        """
        whole("Deployment.verify", "steps", steps, 1, MOST_STEPS)
        whole("Deployment.verify", "seed", seed, 0)
        whole("Deployment.verify", "fuzz_steps", fuzz_steps, 0)
        require_plant(plant)
        plant = self.plant if plant is None else plant
        names = tuple(TARGETS) if targets is None else tuple(targets)
        proof = verify_code(self, compiler.compiler(), steps, seed, names, fuzz_steps)
        law = self.quantised if self.designed is None else self.designed
        loop = None if plant is None else reanalysis(law, self.quantised, plant, tones_hz)
        runs = proof.status.word != StatusWord.NOT_COMPILED
        measured = None
        if bench is not None and runs:
            measured = on_bench(bench, law, self.instance(), tones_hz, plant=plant)
        proof = proof.with_loop(loop, measured)
        self.tables |= proof.figures()
        rewrite(self.folder, self.documents(proof.status))
        return proof

    def bank(self, controller: StateSpace) -> CoefficientBank:
        """Return another controller's coefficients as words and CRC-32, to be loaded while this code runs.

        Raises:
            InputError: the code cannot hold them: another rate, number of channels or states.
        """
        require_discrete(controller, self.law.name)
        return bank_for(self.law, balanced(controller, like=self.given))

    def documents(self, verified: Status | None = None) -> dict[str, str]:
        """Return the texts of README and manifest as things stand."""
        verdict = "Not verified yet." if verified is None else str(verified)
        manifest = {
            "name": self.law.name,
            "model_sha256": self.model_hash,
            "coefficients_sha256": self.law.hash,
            "tables": self.tables,
            "status": asdict(self.status),
            "verified": verdict,
        }
        text = render.readme(self.law, self.model_hash, self.tables, [str(self.status), verdict], cycles.ASSUMPTIONS)
        return {"README.md": text, MANIFEST: manifest_text(manifest)}
