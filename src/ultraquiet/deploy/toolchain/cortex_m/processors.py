"""The Cortex-M that the code is built for and run on by an emulator."""

from pathlib import Path

from ultraquiet.deploy.toolchain.target import Family, Memory, Target

CORTEX_M = Family(
    stem="cortex",
    folder=Path(__file__).parent,
    compiler="arm-none-eabi-gcc",
    size_tool="arm-none-eabi-size",
    emulator="qemu-system-arm",
    counting=("-icount", "shift=10", "-display", "none", "-serial", "none", "-monitor", "none"),
    semihosting=("-semihosting-config", "enable=on,target=native"),
    memory=Memory(code=0x0000_0000, data=0x2000_0000),
    packages=("gcc-arm-none-eabi", "libnewlib-arm-none-eabi", "qemu-system-arm"),
    processor="arm",
)

# At 2^10 ns an instruction the SysTick of the MPS2 boards, 25 MHz, advances 25.6 ticks for each, so counts round
# exactly.
MPS2_TICKS = 25.6

TARGETS = (
    Target(
        CORTEX_M,
        "cortex-m4f",
        "Cortex-M4F",
        ("-mcpu=cortex-m4", "-mthumb", "-mfpu=fpv4-sp-d16", "-mfloat-abi=hard"),
        "mps2-an386",
        MPS2_TICKS,
        168e6,
        "STM32F4, 168 MHz",
        in_hardware=("float32",),
    ),
    Target(
        CORTEX_M,
        "cortex-m7",
        "Cortex-M7",
        ("-mcpu=cortex-m7", "-mthumb", "-mfpu=fpv5-d16", "-mfloat-abi=hard"),
        "mps2-an500",
        MPS2_TICKS,
        216e6,
        "STM32F7, 216 MHz",
        in_hardware=("float32", "float64"),
    ),
)
