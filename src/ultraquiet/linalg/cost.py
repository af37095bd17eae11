"""What one step of a law costs, counted before any code exists."""


def multiply_adds(states: int, inputs: int, outputs: int) -> int:
    """Return the multiply-adds of one step in modal form, x+ = A x + B y, u = C x + D y.

    A of 2x2 blocks costs two a state (an odd state is stored as a pair), B and C a column and a row, D its size:
    n (inputs + outputs + 2) + inputs outputs, which is 14 n + 36 for six by six.

    >>> multiply_adds(36, 6, 6), multiply_adds(35, 6, 6)
    (540, 540)
    """
    return (states + states % 2) * (inputs + outputs + 2) + inputs * outputs


def largest_order(budget: int, inputs: int, outputs: int) -> int:
    """Return the largest order whose step costs at most `budget` multiply-adds, -1 when D alone costs more.

    >>> largest_order(1400, 6, 6), largest_order(35, 6, 6)
    (96, -1)
    """
    left = budget - inputs * outputs
    return -1 if left < 0 else 2 * (left // (2 * (inputs + outputs + 2)))
