"""The paper's method as machine code: regions (eq. 2), cost (eq. 3), Jacobian (eq. 4), both steps (eq. 5 and 6).

The same arithmetic as `handsight.correction.paper`, in the same centimetres, laid out for speed: a region is six
contiguous rows, its costs are written four at a time by the vector unit, nothing of a cloud's size is allocated, and
a Cholesky factorisation stands where the published pseudo-inverse has but one answer.
"""

import numba
import numpy as np

jit = numba.njit(fastmath=True, error_model="numpy", cache=True)

DAMPING, RATE, STEP, TOLERANCE, DESCEND, MOST, PATIENCE, EPSILON, MIN_POINTS, WEIGHT = range(10)
"""What is where in `options`; lengths in cm but EPSILON [m]. DESCEND: gradient descent, not LM."""


@jit
def rotation(q, M):
    """Writes the matrix of `v -> q v q*` (it scales by |q|² too, as published) into M (3, 3)."""
    w, x, y, z = q[0], q[1], q[2], q[3]
    M[0, 0], M[0, 1], M[0, 2] = w * w + x * x - y * y - z * z, 2 * (x * y - w * z), 2 * (x * z + w * y)
    M[1, 0], M[1, 1], M[1, 2] = 2 * (x * y + w * z), w * w - x * x + y * y - z * z, 2 * (y * z - w * x)
    M[2, 0], M[2, 1], M[2, 2] = 2 * (x * z - w * y), 2 * (y * z + w * x), w * w - x * x - y * y + z * z


@jit
def gather(cloud, contact, frame, options, region, squared):
    """Eq. 2 for one contact (3,) in the object's frame [m]: fills region (6, K), answers how many points it has.

    cloud (6, m): points and normals, object's frame [m]. frame (4, 3): palm's axes of the object, and its middle.
    region: [cm], palm's axes, from the middle. squared (m,): to work in.
    """
    m = cloud.shape[1]
    for j in range(m):
        dx, dy, dz = cloud[0, j] - contact[0], cloud[1, j] - contact[1], cloud[2, j] - contact[2]
        squared[j] = dx * dx + dy * dy + dz * dz
    least = min(int(options[MIN_POINTS]), m)
    limit, count = options[EPSILON] ** 2, 0
    for j in range(m):
        count += squared[j] <= limit
    if count < least:
        limit = least_squared(squared, limit, least)
    k = 0
    for j in range(m):
        if squared[j] <= limit:
            for a in range(3):
                p = frame[a, 0] * cloud[0, j] + frame[a, 1] * cloud[1, j] + frame[a, 2] * cloud[2, j]
                u = frame[a, 0] * cloud[3, j] + frame[a, 1] * cloud[4, j] + frame[a, 2] * cloud[5, j]
                region[a, k], region[3 + a, k] = 100.0 * (p - frame[3, a]), u
            k += 1
    return k


@jit
def least_squared(squared, limit, least):
    """The `least`-th smallest, where fewer are within `limit`: a growing ball first, then a selection in it."""
    count = 0
    while count < least:
        limit *= 2.0
        count = 0
        for value in squared:
            count += value <= limit
    within = np.empty(count)
    k = 0
    for value in squared:
        if value <= limit:
            within[k] = value
            k += 1
    return np.partition(within, least - 1)[least - 1]


@jit
def least_cost(region, n, contact, weight, costs):
    """The minimum of eq. 3 over one region of n points, for a moved contact (6,): point and normal."""
    px, py, pz, ux, uy, uz = contact[0], contact[1], contact[2], contact[3], contact[4], contact[5]
    x, y, z, a, b, c = region[0], region[1], region[2], region[3], region[4], region[5]
    for j in range(n):
        dx, dy, dz = px - x[j], py - y[j], pz - z[j]
        cosine = ux * a[j] + uy * b[j] + uz * c[j]
        costs[j] = np.sqrt(dx * dx + dy * dy + dz * dz) + weight * abs(1.0 - cosine)
    best = np.inf
    for j in range(n):
        best = min(best, costs[j])
    return best


@jit
def put(x, M, contact, moved):
    """Writes a contact (6,) moved by x, whose matrix is M, into `moved` (6,)."""
    for a in range(3):
        moved[a] = M[a, 0] * contact[0] + M[a, 1] * contact[1] + M[a, 2] * contact[2] + x[4 + a]
        moved[3 + a] = M[a, 0] * contact[3] + M[a, 1] * contact[4] + M[a, 2] * contact[5]


@jit
def differences(x, h, matching, options, value, jacobian):
    """Eq. 4: writes G(x) (n,) and its forward differences (n, 7). matching: contacts (n, 6), regions, counts."""
    contacts, regions, counts, costs = matching
    weight = options[WEIGHT]
    Ms, stepped, moved = np.empty((8, 3, 3)), np.empty((8, 7)), np.empty(6)
    for i in range(8):
        stepped[i] = x
        if i:
            stepped[i, i - 1] += h
        rotation(stepped[i], Ms[i])
    for c in range(len(contacts)):
        put(x, Ms[0], contacts[c], moved)
        source, count = regions[c], counts[c]
        value[c] = least_cost(source, count, moved, weight, costs)
        for i in range(7):
            put(stepped[i + 1], Ms[i + 1], contacts[c], moved)
            jacobian[c, i] = (least_cost(source, count, moved, weight, costs) - value[c]) / h


@jit
def damped_step(value, jacobian, damping, H, step):
    """Eq. 6: writes (JᵀJ + λ diag JᵀJ)⁺ JᵀG; with λ > 0 only a 0 on the diagonal makes it singular: no step there."""
    for a in range(7):
        step[a] = 0.0
        for c in range(len(value)):
            step[a] += jacobian[c, a] * value[c]
        for b in range(a + 1):
            H[a, b] = 0.0
            for c in range(len(value)):
                H[a, b] += jacobian[c, a] * jacobian[c, b]
        H[a, a] = H[a, a] * (1 + damping) if H[a, a] > 0 else 1.0
    for a in range(7):
        for b in range(a + 1):
            s = H[a, b]
            for k in range(b):
                s -= H[a, k] * H[b, k]
            H[a, b] = s / H[b, b] if b < a else np.sqrt(max(s, 1e-300))
        for k in range(a):
            step[a] -= H[a, k] * step[k]
        step[a] /= H[a, a]
    for a in range(6, -1, -1):
        for k in range(a + 1, 7):
            step[a] -= H[k, a] * step[k]
        step[a] /= H[a, a]


@jit
def advance(x, value, jacobian, options, H, step):
    """x after one step of eq. 5 or 6, its quaternion normalised."""
    if options[DESCEND] > 0:
        for a in range(7):
            step[a] = options[RATE] * (jacobian[:, a] * value).sum()
    else:
        damped_step(value, jacobian, options[DAMPING], H, step)
    for a in range(7):
        x[a] -= step[a]
    length = np.sqrt((x[:4] ** 2).sum())
    for a in range(4):
        x[a] /= length


@jit
def minimise(matching, options):
    """The best x met from the identity on, steps taken, whether it came to rest."""
    x, best = np.zeros(7), np.zeros(7)
    x[0] = best[0] = 1.0
    n = len(matching[0])
    value, jacobian = np.empty(n), np.empty((n, 7))
    H, step = np.empty((7, 7)), np.empty(7)
    lowest = mark = np.inf
    stalled, most = 0, int(options[MOST])
    for iteration in range(most + 1):
        differences(x, options[STEP] * np.sqrt((x**2).sum()), matching, options, value, jacobian)
        cost = np.sqrt((value**2).sum())
        if not cost < 1e12:  # fast arithmetic may not be asked for NaN by name
            return best, iteration, False
        if cost < lowest:
            best[:], lowest = x, cost
        if cost <= mark - options[TOLERANCE]:
            mark, stalled = cost, 0
        else:
            stalled += 1
        if stalled >= int(options[PATIENCE]) or cost == 0:
            return best, iteration, True
        if iteration < most:
            advance(x, value, jacobian, options, H, step)
    return best, most, False


@jit
def correct(cloud, contacts_palm, T, center, options, space):
    """`T_palm_object` after Algorithm 1, steps taken, came to rest.

    cloud (6, m): object's frame. contacts_palm (n, 6). T: vision's pose. center (3,) the object's middle, its frame.
    space: regions (n or more, 6, m) and costs (m,) to work in.
    """
    regions, costs = space
    n = len(contacts_palm)
    frame, local = np.empty((4, 3)), np.empty(3)
    for a in range(3):
        frame[a] = T[a, :3]
        frame[3, a] = T[a, 0] * center[0] + T[a, 1] * center[1] + T[a, 2] * center[2]
    contacts, counts = contacts_palm.copy(), np.empty(n, np.int64)
    for c in range(n):
        for a in range(3):
            contacts[c, a] = 100.0 * (contacts_palm[c, a] - T[a, 3] - frame[3, a])
            local[a] = 0.0
            for b in range(3):
                local[a] += T[b, a] * (contacts_palm[c, b] - T[b, 3])
        counts[c] = gather(cloud, local, frame, options, regions[c], costs)
    x, steps, rested = minimise((contacts, regions, counts, costs), options)
    return answer(x, T, frame[3]), steps, rested


@jit
def answer(x, T, middle):
    """Vision's pose after the inverse of x, which turns about the object's middle."""
    M, new = np.empty((3, 3)), np.zeros((4, 4))
    rotation(x, M)
    for a in range(3):
        for b in range(3):
            for k in range(3):
                new[a, b] += M[k, a] * T[k, b]
            new[a, 3] -= M[b, a] * (middle[b] + x[4 + b] / 100.0)
        new[a, 3] += T[a, 3] + middle[a]
    new[3, 3] = 1.0
    return new
