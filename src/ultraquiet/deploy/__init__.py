"""From a controller to C99 that fits the frame and proves itself on the machine that compiles it.

>>> from ultraquiet import deploy
>>> deploy.kernel_cycles("modal", 60)
1001
"""

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from ultraquiet.deploy.c31.assembly import C31Code as C31Code
    from ultraquiet.deploy.c31.assembly import c31_code as c31_code
    from ultraquiet.deploy.c31.cycles import kernel_cycles as kernel_cycles
    from ultraquiet.deploy.c31.cycles import largest_order as largest_order
    from ultraquiet.deploy.c_code.compiled import CompiledController as CompiledController
    from ultraquiet.deploy.deployment import Deployment as Deployment
    from ultraquiet.deploy.exchange.cmake import write_project as write_project
    from ultraquiet.deploy.exchange.exchange import export_law as export_law
    from ultraquiet.deploy.exchange.exchange import read_law as read_law
    from ultraquiet.deploy.exchange.fmu import FmuFile as FmuFile
    from ultraquiet.deploy.exchange.fmu import write_fmu as write_fmu
    from ultraquiet.deploy.exchange.fmu_controller import FmuController as FmuController
    from ultraquiet.deploy.exchange.foton import foton_text as foton_text
    from ultraquiet.deploy.exchange.foton import read_foton as read_foton
    from ultraquiet.deploy.fixed_point.deployment import FixedDeployment as FixedDeployment
    from ultraquiet.deploy.fixed_point.generation import FixedOptions as FixedOptions
    from ultraquiet.deploy.fixed_point.generation import generate_fixed as generate_fixed
    from ultraquiet.deploy.fixed_point.law import FixedLaw as FixedLaw
    from ultraquiet.deploy.fixed_point.scaling import fixed_law as fixed_law
    from ultraquiet.deploy.fixed_point.twin import FixedTwin as FixedTwin
    from ultraquiet.deploy.fixed_point.word_lengths import WordLength as WordLength
    from ultraquiet.deploy.fixed_point.word_lengths import word_lengths as word_lengths
    from ultraquiet.deploy.frame.controller import FrameController as FrameController
    from ultraquiet.deploy.frame.frame import Frame as Frame
    from ultraquiet.deploy.frame.result import FrameSimulation as FrameSimulation
    from ultraquiet.deploy.frame.settings import Overload as Overload
    from ultraquiet.deploy.frame.times import FrameTimes as FrameTimes
    from ultraquiet.deploy.generation import generate as generate
    from ultraquiet.deploy.law.anti_windup import conditioning_gain as conditioning_gain
    from ultraquiet.deploy.law.law import Law as Law
    from ultraquiet.deploy.law.realisation import Realisation as Realisation
    from ultraquiet.deploy.law.realisation import realisation as realisation
    from ultraquiet.deploy.law.twin import Twin as Twin
    from ultraquiet.deploy.law.word_length import WordFormat as WordFormat
    from ultraquiet.deploy.law.word_length import rounding_errors as rounding_errors
    from ultraquiet.deploy.options import C31Budget as C31Budget
    from ultraquiet.deploy.options import CodeOptions as CodeOptions
    from ultraquiet.deploy.processor_in_loop import Processor as Processor
    from ultraquiet.deploy.verification.bench_tones import OnBench as OnBench
    from ultraquiet.deploy.verification.bench_tones import on_bench as on_bench
    from ultraquiet.deploy.verification.emulated_target import OnTarget as OnTarget
    from ultraquiet.deploy.verification.rounded_loop import Reanalysis as Reanalysis
    from ultraquiet.deploy.verification.rounded_loop import reanalysis as reanalysis
    from ultraquiet.deploy.verification.verify import Verification as Verification

_HOME = {
    "C31Budget": "options",
    "C31Code": "c31.assembly",
    "CodeOptions": "options",
    "CompiledController": "c_code.compiled",
    "Deployment": "deployment",
    "FixedDeployment": "fixed_point.deployment",
    "FixedOptions": "fixed_point.generation",
    "FixedLaw": "fixed_point.law",
    "FixedTwin": "fixed_point.twin",
    "FmuController": "exchange.fmu_controller",
    "FmuFile": "exchange.fmu",
    "Frame": "frame.frame",
    "FrameController": "frame.controller",
    "FrameSimulation": "frame.result",
    "FrameTimes": "frame.times",
    "Law": "law.law",
    "OnBench": "verification.bench_tones",
    "OnTarget": "verification.emulated_target",
    "Overload": "frame.settings",
    "Processor": "processor_in_loop",
    "Realisation": "law.realisation",
    "Reanalysis": "verification.rounded_loop",
    "Twin": "law.twin",
    "Verification": "verification.verify",
    "WordFormat": "law.word_length",
    "WordLength": "fixed_point.word_lengths",
    "c31_code": "c31.assembly",
    "conditioning_gain": "law.anti_windup",
    "export_law": "exchange.exchange",
    "fixed_law": "fixed_point.scaling",
    "foton_text": "exchange.foton",
    "generate": "generation",
    "generate_fixed": "fixed_point.generation",
    "kernel_cycles": "c31.cycles",
    "largest_order": "c31.cycles",
    "read_foton": "exchange.foton",
    "read_law": "exchange.exchange",
    "on_bench": "verification.bench_tones",
    "realisation": "law.realisation",
    "reanalysis": "verification.rounded_loop",
    "rounding_errors": "law.word_length",
    "word_lengths": "fixed_point.word_lengths",
    "write_fmu": "exchange.fmu",
    "write_project": "exchange.cmake",
}

__all__ = list(_HOME)  # pyright: ignore[reportUnsupportedDunderAll]


def __getattr__(name: str) -> Any:
    if name in _HOME:
        return getattr(importlib.import_module(f"ultraquiet.deploy.{_HOME[name]}"), name)
    raise AttributeError(f"module 'ultraquiet.deploy' has no attribute {name!r}")


def __dir__() -> list[str]:
    return list(__all__)
