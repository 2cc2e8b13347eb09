"""The nearest of an object's samples."""

from typing import Any

import numpy as np

from handsight._compiled.jit import inner
from handsight._compiled.records import SAMPLES, record
from handsight._compiled.stack import local

PRODUCTS = record(("values", "f4", (SAMPLES,)))
QUARTER = SAMPLES // 4


@inner
def scan(table: Any, query: Any) -> int:
    """Returns the column of a table (7, SAMPLES) that has the least product with a query, of equal ones the first.

    Both are float32. The least of each quarter is looked for in one loop, because the processor overlaps the four.
    """
    products = local(PRODUCTS).values
    for k in range(SAMPLES):
        point = (
            query[0] * table[0, k] + query[1] * table[1, k] + query[2] * table[2, k] + query[3] * table[3, k]
        )
        products[k] = point + query[4] * table[4, k] + query[5] * table[5, k] + query[6] * table[6, k]
    a = b = c = d = np.float32(np.inf)
    at_a = 0
    at_b = QUARTER
    at_c = 2 * QUARTER
    at_d = 3 * QUARTER
    for k in range(QUARTER):
        if products[k] < a:
            a = products[k]
            at_a = k
        if products[QUARTER + k] < b:
            b = products[QUARTER + k]
            at_b = QUARTER + k
        if products[2 * QUARTER + k] < c:
            c = products[2 * QUARTER + k]
            at_c = 2 * QUARTER + k
        if products[3 * QUARTER + k] < d:
            d = products[3 * QUARTER + k]
            at_d = 3 * QUARTER + k
    if b < a:
        a, at_a = b, at_b
    if d < c:
        c, at_c = d, at_d
    return at_c if c < a else at_a
