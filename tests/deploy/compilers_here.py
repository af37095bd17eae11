"""The compilers of this machine, those that Debian names with their version among them."""

import shutil

NEWEST, OLDEST = 40, 11  # versions asked for by name; clang has its attributes of functions from 11 on


def versions(*names, oldest=OLDEST):
    """Yield the paths of programs that stand here together: by their plain names, then `name-NN`, newest first."""
    for ending in ("", *(f"-{k}" for k in range(NEWEST, oldest - 1, -1))):
        found = [shutil.which(name + ending) for name in names]
        if all(found):
            yield found


def compiler(name):
    """Return the path of a compiler, or None."""
    return next((found[0] for found in versions(name)), None)
