"""Functions that FMI wants every unit to export and a sampled controller has no use for: name, arguments, may be empty.

Reference: fmi2FunctionTypes.h of FMI 2.0.4 and fmi3FunctionTypes.h of FMI 3.0.1.
"""

_R2, _R3 = "const unsigned int *", "const uint32_t *"
_STRINGS = "const char *const *"


def _typed(kinds: dict[str, str], verbs: str) -> list[tuple[str, list[str], bool]]:
    """Return getters and setters of FMI 3.0 for variables of types that the unit does not have."""
    functions: list[tuple[str, list[str], bool]] = []
    for kind, c_type in kinds.items():
        for verb in verbs.split():
            to = f"{c_type}*" if verb == "Get" else f"const {c_type}*"
            functions.append((f"fmi3{verb}{kind}", [_R3, "size_t ", to, "size_t "], True))
    return functions


_SIZES = {"Int8": "int8_t ", "UInt8": "uint8_t ", "Int16": "int16_t ", "UInt16": "uint16_t ", "Int32": "int32_t "}
_MORE = {"Int64": "int64_t ", "UInt64": "uint64_t ", "Float32": "float "}
_REALS = "const double *"

TWO: list[tuple[str, list[str], bool]] = [
    ("fmi2GetString", [_R2, "size_t ", "const char **"], True),
    ("fmi2SetString", [_R2, "size_t ", _STRINGS], True),
    ("fmi2SetInteger", [_R2, "size_t ", "const int *"], True),
    ("fmi2SerializedFMUstateSize", ["void *", "size_t *"], False),
    ("fmi2SerializeFMUstate", ["void *", "char *", "size_t "], False),
    ("fmi2DeSerializeFMUstate", ["const char *", "size_t ", "void **"], False),
    ("fmi2GetDirectionalDerivative", [_R2, "size_t ", _R2, "size_t ", _REALS, "double *"], False),
    ("fmi2SetRealInputDerivatives", [_R2, "size_t ", "const int *", _REALS], True),
    ("fmi2GetRealOutputDerivatives", [_R2, "size_t ", "const int *", "double *"], True),
    ("fmi2CancelStep", [], False),
    ("fmi2GetStatus", ["int ", "int *"], False),
    ("fmi2GetRealStatus", ["int ", "double *"], False),
    ("fmi2GetIntegerStatus", ["int ", "int *"], False),
    ("fmi2GetBooleanStatus", ["int ", "int *"], False),
    ("fmi2GetStringStatus", ["int ", "const char **"], False),
]

THREE: list[tuple[str, list[str], bool]] = [
    *_typed(_SIZES, "Get Set"),
    *_typed(_MORE, "Get Set"),
    *_typed({"UInt32": "uint32_t "}, "Set"),
    ("fmi3GetString", [_R3, "size_t ", "const char **", "size_t "], True),
    ("fmi3SetString", [_R3, "size_t ", _STRINGS, "size_t "], True),
    ("fmi3GetBinary", [_R3, "size_t ", "size_t *", "const uint8_t **", "size_t "], True),
    ("fmi3SetBinary", [_R3, "size_t ", "const size_t *", "const uint8_t *const *", "size_t "], True),
    ("fmi3GetClock", [_R3, "size_t ", "bool *"], True),
    ("fmi3SetClock", [_R3, "size_t ", "const bool *"], True),
    ("fmi3GetNumberOfVariableDependencies", ["uint32_t ", "size_t *"], False),
    ("fmi3GetVariableDependencies", ["uint32_t ", "size_t *", "uint32_t *", "size_t *", "int *", "size_t "], False),
    ("fmi3SerializedFMUStateSize", ["void *", "size_t *"], False),
    ("fmi3SerializeFMUState", ["void *", "uint8_t *", "size_t "], False),
    ("fmi3DeserializeFMUState", ["const uint8_t *", "size_t ", "void **"], False),
    (
        "fmi3GetDirectionalDerivative",
        [_R3, "size_t ", _R3, "size_t ", _REALS, "size_t ", "double *", "size_t "],
        False,
    ),
    ("fmi3GetAdjointDerivative", [_R3, "size_t ", _R3, "size_t ", _REALS, "size_t ", "double *", "size_t "], False),
    ("fmi3EnterConfigurationMode", [], False),
    ("fmi3ExitConfigurationMode", [], False),
    ("fmi3GetIntervalDecimal", [_R3, "size_t ", "double *", "int *"], True),
    ("fmi3GetIntervalFraction", [_R3, "size_t ", "uint64_t *", "uint64_t *", "int *"], True),
    ("fmi3GetShiftDecimal", [_R3, "size_t ", "double *"], True),
    ("fmi3GetShiftFraction", [_R3, "size_t ", "uint64_t *", "uint64_t *"], True),
    ("fmi3SetIntervalDecimal", [_R3, "size_t ", _REALS], True),
    ("fmi3SetIntervalFraction", [_R3, "size_t ", "const uint64_t *", "const uint64_t *"], True),
    ("fmi3SetShiftDecimal", [_R3, "size_t ", _REALS], True),
    ("fmi3SetShiftFraction", [_R3, "size_t ", "const uint64_t *", "const uint64_t *"], True),
    ("fmi3EvaluateDiscreteStates", [], False),
    ("fmi3UpdateDiscreteStates", ["bool *", "bool *", "bool *", "bool *", "bool *", "double *"], False),
    ("fmi3EnterEventMode", [], False),
    ("fmi3EnterContinuousTimeMode", [], False),
    ("fmi3CompletedIntegratorStep", ["bool ", "bool *", "bool *"], False),
    ("fmi3SetTime", ["double "], False),
    ("fmi3SetContinuousStates", [_REALS, "size_t "], False),
    ("fmi3GetContinuousStateDerivatives", ["double *", "size_t "], False),
    ("fmi3GetEventIndicators", ["double *", "size_t "], False),
    ("fmi3GetContinuousStates", ["double *", "size_t "], False),
    ("fmi3GetNominalsOfContinuousStates", ["double *", "size_t "], False),
    ("fmi3GetNumberOfEventIndicators", ["size_t *"], False),
    ("fmi3GetNumberOfContinuousStates", ["size_t *"], False),
    ("fmi3EnterStepMode", [], False),
    ("fmi3GetOutputDerivatives", [_R3, "size_t ", "const int32_t *", "double *", "size_t "], True),
    ("fmi3ActivateModelPartition", ["uint32_t ", "double "], False),
]

REFUSED = {"2.0": TWO, "3.0": THREE}
