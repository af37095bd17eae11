"""Kept for one round: use `ultraquiet.deploy.cortex`."""

from ultraquiet.deploy.cortex import COMPILER as COMPILER
from ultraquiet.deploy.cortex import EMULATOR as EMULATOR
from ultraquiet.deploy.cortex import Count as Count
from ultraquiet.deploy.cortex import count_instructions as count_instructions
from ultraquiet.deploy.cortex import missing_tool as missing_tool
