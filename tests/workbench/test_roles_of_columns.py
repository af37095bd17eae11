"""What a file's columns are is guessed from names and units; where those do not tell, it is said."""

import pytest

from ultraquiet.workbench.engine.roles import guessed_roles


def guessed(*columns):
    """What each column of a name, a unit and a role of the file is taken for, by its first letter, and what is said."""
    channels = [{"name": c[0], "unit": c[1], "role": "".join(c[2:])} for c in columns]
    roles, doubt = guessed_roles(channels)
    return "".join(role[0] for role in roles), doubt


@pytest.mark.parametrize(
    ("columns", "roles"),
    [
        ((("i1", "A"), ("i2", "A"), ("cmd 3", "V"), ("v1", "m/s")), "iiio"),
        ((("i1", "A"), ("i2", "A"), ("third", "V"), ("v1", "m/s")), "iiio"),
        ((("accel", "g"), ("drive", "V")), "oi"),
        ((("position command", "mm"), ("force sensor", "N")), "io"),
        ((("u_1", "V"), ("y_1", "V"), ("y_2", "V")), "ioo"),
        ((("shaker", "V"), ("geophone", "V"), ("laser", "V")), "ioo"),
        ((("F1", "N"), ("F2", "kN"), ("x1", "mm"), ("x2", "µm/s^2")), "iioo"),
        ((("a", "V", "output"), ("b", "V", "input")), "oi"),
    ],
)
def test_names_and_units_tell(columns, roles):
    assert guessed(*columns) == (roles, "")


@pytest.mark.parametrize(
    ("columns", "roles", "named"),
    [
        ((("a", "V"), ("b", "V"), ("c", "V")), "ioo", "a, b, c"),
        ((("a", ""), ("b", "")), "io", "a, b"),
        ((("a", "A"), ("b", "m"), ("c", "")), "ioo", "c"),
        ((("force", "N"), ("voltage", "V")), "io", "force, voltage"),
        ((("a", "", "input"), ("b", ""), ("c", "")), "ioo", "b, c"),
        ((("F", "N"), ("coil speed", "A"), ("x", "m")), "iio", "coil speed"),
    ],
)
def test_where_they_do_not_tell_it_is_said(columns, roles, named):
    found, doubt = guessed(*columns)
    assert found == roles
    assert f"for sure what {named} " in doubt
