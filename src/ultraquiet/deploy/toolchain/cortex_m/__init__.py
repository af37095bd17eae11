"""Arm's Cortex-M under QEMU, compiled by arm-none-eabi-gcc; a new one is an entry of `TARGETS`."""
