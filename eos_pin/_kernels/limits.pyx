# cython: language_level=3, boundscheck=False, wraparound=False, cdivision=True, initializedcheck=False
"""Compiled twins of the limits of a step, and of the quadratic program of the smallest change within them."""

cimport numpy as cnp
from libc.math cimport INFINITY, fabs, isfinite, sqrt

from eos_pin._kernels._common cimport as_plain, as_table, data, dot, empty, entry

import numpy as np

from eos_pin._kernels import dispatch

cnp.import_array()

cdef int DONE = dispatch.DONE, UNDECIDED = dispatch.UNDECIDED, NO_ANSWER = dispatch.NO_ANSWER
#: Rounds in which the active bounds of a program are looked for; their most rows and unknowns; the part of its square
#: that a row must have beyond the rows before it; and the rounding that is allowed in a bound, as a part of it.
cdef enum:
    ROUNDS = 6
    MOST_ROWS = 96
    MOST_UNKNOWNS = 32
    # Sides of a row beside inactive, 0, and at a bound, ±1: beyond it at a price, ±2, and exactly zero.
    PAYING = 2
    WHOLE = 3
cdef double APART = 1e-9, ROUNDING = 1e-11


cdef class Limits:
    """`plain_parts.Limits`.

    Args:
        period: Control period.
        rate, ends, fastest, braking, acceleration: As for `plain_parts.Viability`.
        torque: Largest torques, (n,).
        clear: How much more each joint may be accelerated where limits are not looked at more closely.
        fast, times, met, model, smallest: As for `plain_parts.Limits`.
    """

    cdef Py_ssize_t n, times
    cdef double half, rate, clear, fast, met
    cdef double *ends
    cdef double *fastest
    cdef double *braking
    cdef double *acceleration
    cdef double *torque
    cdef double *least
    cdef double *most
    cdef double *factor
    cdef object model, smallest
    cdef tuple made_from, kept

    def __init__(self, period, rate, ends, fastest, braking, acceleration, torque, clear, fast, times, met, model, smallest):
        self.made_from = period, rate, ends, fastest, braking, acceleration, torque, clear, fast, times, met, model, smallest
        self.half, self.rate, self.clear, self.fast, self.times = 0.5 * period, rate, clear, fast, times
        self.met, self.model, self.smallest = met, model, smallest
        self.n = n = len(torque)
        vectors = tuple(np.array(x, dtype=float) for x in (ends, fastest, braking, acceleration, torque))
        self.kept = *vectors, np.empty(n), np.empty(n), np.empty(n * n)
        self.ends, self.fastest, self.braking, self.acceleration = (
            data(vectors[0]), data(vectors[1]), data(vectors[2]), data(vectors[3])
        )
        self.torque, self.least, self.most, self.factor = (
            data(vectors[4]), data(self.kept[5]), data(self.kept[6]), data(self.kept[7])
        )

    def __reduce__(self):
        return type(self), self.made_from

    cdef double bound(self, Py_ssize_t i, double q, double dq) noexcept:
        """Largest acceleration of a joint towards a limit."""
        cdef double room = self.ends[i] - q, b = self.braking[i], speed = self.rate * dq
        cdef double root = sqrt(2.0 * self.rate * self.rate * b * max(room, 0.0) + b * b)
        cdef double beyond = self.rate * self.rate * min(room, 0.0), slower = 1.0 - beyond / self.fastest[i]
        cdef double most = root - b + beyond / slower - b / root * speed / (slower * slower)
        return min(max(min(most, self.fastest[i]) - speed, -self.acceleration[i]), self.acceleration[i])

    cdef double kept_to(self, Py_ssize_t i, double ddq) noexcept:
        return min(max(ddq, self.least[i]), self.most[i])

    def __call__(self, joints, velocities, accelerations, J):
        cdef Py_ssize_t n = self.n, i, j, k
        cdef double up, down, part = 0.0, room = INFINITY, miss, off, linear
        cdef bint tight
        cdef cnp.ndarray q = as_plain(joints, n), dq = as_plain(velocities, n), ddq = as_plain(accelerations, n)
        cdef cnp.ndarray tau = self.model._inverse_dynamics(q, dq, ddq)
        cdef cnp.ndarray change = empty(n)
        for i in range(n):
            up, down = self.bound(i, data(q)[i], data(dq)[i]), self.bound(n + i, -data(q)[i], -data(dq)[i])
            room = min(room, min(up - data(ddq)[i], down + data(ddq)[i]))
            part += (data(tau)[i] / self.torque[i]) * (data(tau)[i] / self.torque[i])
            self.most[i], self.least[i] = up, min(-down, up)
            data(change)[i] = 0.0
        if part < 1.0 and room > self.clear:
            return tau, change
        cdef cnp.ndarray below = empty(2 * n), above = empty(2 * n), shift = empty(n)
        cdef cnp.ndarray mean, more, M, asked, found, held, effort
        for i in range(n):
            data(shift)[i] = self.kept_to(i, data(ddq)[i])
        at, speed = self.halfway(q, dq, shift, None)
        M = self.model._mass(at)
        for i in range(n):
            for j in range(n):
                self.factor[i * n + j] = entry(M, i, j)
        factorize(self.factor, n, 0.0)
        mean = self.accelerations(self.model._bias(at, speed), tau)
        # Once more, from where the torque leads to.
        for i in range(n):
            data(shift)[i] = self.kept_to(i, data(mean)[i])
        at, speed = self.halfway(q, dq, shift, None)
        more, asked = self.accelerations(self.model._inverse_dynamics(at, speed, mean), tau), empty(n)
        for i in range(n):
            data(mean)[i] += data(more)[i]
            data(asked)[i] = self.kept_to(i, data(mean)[i])
            # So that without a change the middle stays where it is, and the torque is continuous.
            data(shift)[i] -= data(asked)[i]
        found = self.predicted(q, dq, tau, mean, asked)
        if self.within(found, tau, below, above):
            return tau, change
        for k in range(self.times):
            change, asked = self.smallest(J, M, below, above), empty(n)
            for i in range(n):
                data(asked)[i] = data(mean)[i] + data(change)[i]
            at, speed = self.halfway(q, dq, asked, shift)
            held, effort = self.model._inverse_dynamics(at, speed, asked), empty(n)
            # Where joints are lost, all depends on what torques can do.
            found, miss, off, tight = self.predicted(q, dq, held, asked, asked), 0.0, 0.0, self.smallest.lost
            for i in range(n):
                # What is missed: of the accelerations that were to be, and of the torques that were to give them.
                miss = max(miss, fabs(data(above)[i] + data(found)[i] - data(change)[i] - self.most[i]))
                linear = 0.0
                for j in range(n):
                    linear += entry(M, i, j) * data(change)[j]
                data(effort)[i] = self.torque[i] - data(above)[n + i] + linear
                off = max(off, fabs(data(held)[i] - data(effort)[i]) / entry(M, i, i))
                # Daqp keeps its bounds to 1e-6.
                tight |= max(fabs(data(effort)[i]), fabs(data(held)[i])) >= (1.0 - 1e-6) * self.torque[i]
                data(asked)[i] = data(held)[i] - linear
                data(found)[i] -= data(change)[i]
            if miss < self.met and (off < self.met or not tight):
                break
            self.within(found, asked, below, above)
        # A torque that is used up is used up to the last digit.
        if tight:
            held = effort
        for i in range(n):
            data(held)[i] = min(max(data(held)[i], -self.torque[i]), self.torque[i])
        return held, change

    cdef tuple halfway(self, cnp.ndarray q, cnp.ndarray dq, cnp.ndarray ddq, cnp.ndarray more):
        """The state in the middle of the period."""
        cdef Py_ssize_t i
        cdef cnp.ndarray at = empty(self.n), speed = empty(self.n)
        for i in range(self.n):
            data(speed)[i] = data(dq)[i] + self.half * (data(ddq)[i] + (0.0 if more is None else data(more)[i]))
            data(at)[i] = data(q)[i] + 0.5 * self.half * (data(dq)[i] + data(speed)[i])
        return at, speed

    cdef cnp.ndarray predicted(self, cnp.ndarray q, cnp.ndarray dq, cnp.ndarray tau, cnp.ndarray mean, cnp.ndarray ddq):
        """Mean acceleration over a period: that of its middle, or of its whole motion where a joint is fast."""
        cdef double fastest = 0.0, part
        cdef cnp.ndarray found = empty(self.n), whole
        cdef Py_ssize_t i
        for i in range(self.n):
            part = max(fabs(data(dq)[i]), fabs(data(dq)[i] + 2.0 * self.half * data(ddq)[i]))
            fastest = max(fastest, self.rate * part / self.fastest[i])
            data(found)[i] = data(mean)[i]
        if fastest > self.fast:
            whole, part = self.held(q, dq, tau), min(fastest - self.fast, 1.0)
            for i in range(self.n):
                data(found)[i] += part * (data(whole)[i] - data(found)[i])
        return found

    cdef cnp.ndarray accelerations(self, cnp.ndarray bias, cnp.ndarray tau):
        """M⁻¹ (tau − bias)."""
        cdef cnp.ndarray ddq = empty(self.n)
        cdef Py_ssize_t i
        for i in range(self.n):
            data(ddq)[i] = data(tau)[i] - data(bias)[i]
        substitute(self.factor, self.n, data(ddq))
        return ddq

    cdef cnp.ndarray held(self, cnp.ndarray q, cnp.ndarray dq, cnp.ndarray tau):
        """Mean acceleration over a period in which a torque is held, by a step of Nyström's method."""
        cdef Py_ssize_t n = self.n, i
        cdef cnp.ndarray at, speed, last = self.model._forward_dynamics(q, dq, tau), mean = last / 6.0
        cdef double step, weight
        for step, weight in ((self.half, 1.0 / 3.0), (self.half, 1.0 / 3.0), (2.0 * self.half, 1.0 / 6.0)):
            at, speed = empty(n), empty(n)
            for i in range(n):
                data(speed)[i] = data(dq)[i] + step * data(last)[i]
                data(at)[i] = data(q)[i] + 0.5 * step * (data(dq)[i] + data(speed)[i])
            last = self.model._forward_dynamics(at, speed, tau)
            for i in range(n):
                data(mean)[i] += weight * data(last)[i]
        return mean

    cdef bint within(self, cnp.ndarray mean, cnp.ndarray tau, cnp.ndarray below, cnp.ndarray above) noexcept:
        """Whether accelerations and torques are within their limits; how far off these are, below and above."""
        cdef Py_ssize_t n = self.n, i
        cdef bint inside = True
        for i in range(n):
            data(below)[i], data(above)[i] = self.least[i] - data(mean)[i], self.most[i] - data(mean)[i]
            data(below)[n + i], data(above)[n + i] = -self.torque[i] - data(tau)[i], self.torque[i] - data(tau)[i]
        for i in range(2 * n):
            inside &= data(below)[i] <= 0.0 <= data(above)[i]
        return inside


cdef bint factorize(double* A, Py_ssize_t n, double apart) noexcept nogil:
    """Cholesky's factor in the lower triangle; False where a row has not more than a part of its square of its own."""
    cdef Py_ssize_t i, j
    cdef double square
    for i in range(n):
        square = A[i * n + i]
        for j in range(i):
            A[i * n + j] = (A[i * n + j] - dot(A + i * n, A + j * n, j)) / A[j * n + j]
        A[i * n + i] = square - dot(A + i * n, A + i * n, i)
        if not A[i * n + i] > apart * square:
            return False
        A[i * n + i] = sqrt(A[i * n + i])
    return True


cdef void substitute(double* L, Py_ssize_t n, double* x) noexcept nogil:
    """x becomes (L Lᵀ)⁻¹ x."""
    cdef Py_ssize_t i, j
    for i in range(n):
        x[i] = (x[i] - dot(L + i * n, x, i)) / L[i * n + i]
    for i in range(n - 1, -1, -1):
        for j in range(i + 1, n):
            x[i] -= L[j * n + i] * x[j]
        x[i] /= L[i * n + i]


cdef inline double rounding(double bound) noexcept nogil:
    return ROUNDING * (fabs(bound) + 0.1)


cdef class ChangeProgram:
    """`plain_parts.ChangeProgram`, with the same arguments.

    The solution is looked for where it mostly is, by the primal–dual active set method (Hintermüller, Ito, Kunisch,
    SIAM J. Optim. 2002): bounds that are passed become active, those that pull the wrong way do not stay so. What
    comes to rest fulfils all conditions of the minimum, which is unique. daqp has the rest.
    """

    cdef object update, solve
    cdef tuple made_from, arguments
    cdef double *rows
    cdef double *upper
    cdef double *lower
    cdef double full_price, price, per_weight
    cdef Py_ssize_t m, n
    cdef int side[MOST_ROWS]
    cdef double pull[MOST_ROWS]
    cdef bint small

    def __init__(
        self, model, cnp.ndarray rows, cnp.ndarray upper, cnp.ndarray lower, cnp.ndarray kinds, full_price, price, weight
    ):
        self.made_from = model, rows, upper, lower, kinds, full_price, price, weight
        # Neither H nor f changes.
        self.update, self.solve, self.arguments = model.update, model.solve, (None, None, rows, upper, lower, kinds)
        self.rows, self.upper, self.lower, self.full_price = data(rows), data(upper), data(lower), full_price
        self.price, self.per_weight = price, 1.0 / weight
        self.n, self.m = rows.shape[1], rows.shape[0] - rows.shape[1]
        self.small = self.n <= MOST_UNKNOWNS and 2 * self.n + self.m <= MOST_ROWS

    def __reduce__(self):
        return type(self), self.made_from

    def __call__(self, jacobian, mass, least, most):
        cdef Py_ssize_t n = self.n, m = self.m, i, j
        cdef cnp.ndarray J = as_table(jacobian, m, n), M = as_table(mass, n, n)
        cdef cnp.ndarray lower = as_plain(least, 2 * n), upper = as_plain(most, 2 * n), change = empty(n), paid
        cdef double size
        for i in range(n):
            for j in range(n):
                self.rows[i * n + j] = entry(M, i, j)
        for i in range(m):
            for j in range(n):
                self.rows[(n + i) * n + j] = entry(J, i, j)
        for i in range(2 * n):
            self.lower[i], self.upper[i] = data(lower)[i], data(upper)[i]
        if self.small and self.at_rest(data(change)):
            return DONE, change
        self.update(*self.arguments)
        change, _, flag, info = self.solve()
        if not (flag > 0 and isfinite(dot(data(change), data(change), n))):
            return NO_ANSWER, change
        paid = info["lam"]
        size = dot(data(paid), data(paid), n)
        return DONE if size < self.full_price * self.full_price else UNDECIDED, change

    cdef bint at_rest(self, double* x) noexcept nogil:
        """Whether the active set method comes to rest, where the smallest change x is then."""
        cdef Py_ssize_t n = self.n, m = self.m, k
        cdef int attempt
        # Bounds that zero passes, to begin with, and the task as it is; a band has a lower bound that is far away.
        for k in range(2 * n + m):
            self.side[k] = 1 if self.upper[k] < 0.0 else -1 if self.lower[k] > 0.0 else 0
            if k >= 2 * n and self.lower[k] == -self.upper[k]:
                self.side[k] = WHOLE
        for attempt in range(ROUNDS):
            if not self.on_sides(x):
                return False
            if self.settled(x):
                # Nobody pays the full price of a limit.
                return dot(self.pull, self.pull, 2 * n + m) < self.full_price * self.full_price
        return False

    cdef bint on_sides(self, double* x) noexcept nogil:
        """Smallest change with the active rows on their bounds; their multipliers into `pull`."""
        cdef Py_ssize_t n = self.n, count = 0, i, j, k
        cdef Py_ssize_t active[MOST_UNKNOWNS]
        cdef double gram[MOST_UNKNOWNS * MOST_UNKNOWNS]
        cdef double pull[MOST_UNKNOWNS]
        for k in range(2 * n + self.m):
            self.pull[k] = 0.0
            if self.side[k] != 0:
                if count == n:
                    return False
                active[count] = k
                count += 1
        for i in range(count):
            k = active[i]
            for j in range(i + 1):
                gram[i * count + j] = self.product(k, active[j])
            pull[i] = 0.0 if self.side[k] == WHOLE else self.upper[k] if self.side[k] > 0 else self.lower[k]
            if self.side[k] == PAYING or self.side[k] == -PAYING:
                gram[i * count + i] += self.per_weight
                pull[i] -= self.price * self.per_weight * (1.0 if self.side[k] > 0 else -1.0)
        if not factorize(gram, count, APART):
            return False
        substitute(gram, count, pull)
        for j in range(n):
            x[j] = 0.0
        for i in range(count):
            k = active[i]
            self.pull[k] = pull[i]
            if k < n:
                x[k] += pull[i]
            else:
                for j in range(n):
                    x[j] += pull[i] * self.rows[(k - n) * n + j]
        return True

    cdef double product(self, Py_ssize_t k, Py_ssize_t l) noexcept nogil:
        """Inner product of two rows; the first n are those of the unit matrix."""
        cdef Py_ssize_t n = self.n
        if l < n:
            return <double>(k == l) if k < n else self.rows[(k - n) * n + l]
        return self.rows[(l - n) * n + k] if k < n else dot(self.rows + (k - n) * n, self.rows + (l - n) * n, n)

    cdef bint settled(self, double* x) noexcept nogil:
        """Whether each row is where it should be; one that is not changes its side."""
        cdef Py_ssize_t n = self.n, k
        cdef int side, way, then
        cdef double value, room, against
        cdef bint settled = True
        for k in range(2 * n + self.m):
            side = then = self.side[k]
            if side == 0:
                value = x[k] if k < n else dot(self.rows + (k - n) * n, x, n)
                if value > self.upper[k] + rounding(self.upper[k]):
                    then = 1
                elif value < self.lower[k] - rounding(self.lower[k]):
                    then = -1
            else:
                way = (-1 if self.pull[k] > 0.0 else 1) if side == WHOLE else 1 if side > 0 else -1
                against = -way * self.pull[k]
                if against < 0.0:
                    then = 0
                elif k >= 2 * n and against >= self.price:
                    then = way * PAYING
                else:
                    then = way
            settled &= then == side
            self.side[k] = then
        return settled
