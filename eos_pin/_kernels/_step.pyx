# cython: language_level=3, boundscheck=False, wraparound=False, cdivision=True, initializedcheck=False
"""An ordinary step of `KinematicLoop` in one call; what is not ordinary is left to the loop itself.

The loop's own methods are the plain form, to be read there.
"""

cimport numpy as cnp
from libc.math cimport INFINITY, fabs, floor, rint, sqrt

from eos_pin._kernels._chain cimport AXIS, MOST_JOINTS, MOST_PARTS, MOST_ROWS, ORIENTATION, POSE, Chain
from eos_pin._kernels._common cimport data, dot, empty, named, plain
from eos_pin._kernels._turns cimport follow_arc, rotate
from eos_pin._kernels.law cimport AccelerationMap

import numpy as np

from eos_pin._kernels import dispatch

cnp.import_array()

cdef int DONE = dispatch.DONE
cdef double TAU = 6.283185307179586


cdef class KinematicStep(AccelerationMap):
    """Steps on one chart where no limit is active, no direction fades and the chart serves.

    Args:
        drive: Arguments of the `AccelerationMap`.
        chain: Kinematics of the task.
        chart: Base point of the chart, (n,), and v less Wᵀ q, (r,).
        continuous: Which joints turn without end, (n,).
        turn, threshold: Angle from the base point, and margin, at which a chart is left.
        serves: Whether the chart serves where the Jacobian is the argument, for where the margin's bound is too low.
        factors: Both factors of the task's errors, (m,) each.
        held: v_d that is held, and both factors of its errors, (r,) each; None where the law is another.
        objective, reference: Whose targets they are; the loop begins anew where the state has those of others.
        box: Ends of both ways, largest speeds, changes of velocity, and those of braking, (2n,) each.
        endless: A way that counts as without end.
        period: Control period.
        jump, most_lag: Distances by which a measured joint may move and may be away from its command.
        solved, most_steps: Square of the task error that may be left, and most steps of Newton's method.
    """

    cdef Chain chain
    cdef object objective, reference, serves
    cdef double turn, threshold, period, jump, most_lag, solved, endless
    cdef double *q_bar
    cdef double *v_zero
    cdef double *continuous
    cdef double *a1
    cdef double *a2
    cdef double *v_d
    cdef double *b1
    cdef double *b2
    cdef double *ends
    cdef double *fastest
    cdef double *change
    cdef double *brake
    cdef readonly cnp.ndarray held
    cdef int most_steps

    def __init__(self, drive, chain, chart, continuous, turn, threshold, serves, factors, held, objective, reference,
                 box, endless, period, jump, most_lag, solved, most_steps):
        super().__init__(*drive)
        cdef int n = self.n, m = self.m, r = n - m
        rows = *chart, continuous, *factors, *(held or (np.zeros(r),) * 3), *box
        sizes = n, r, n, m, m, r, r, r, *((2 * n,) * 4)
        copies = tuple(
            np.array(np.broadcast_to(row, (size,)), dtype=float) for row, size in zip(rows, sizes, strict=True)
        )
        self.kept += copies
        self.q_bar, self.v_zero, self.continuous, self.a1, self.a2, self.v_d, self.b1, self.b2 = (
            data(copies[0]), data(copies[1]), data(copies[2]), data(copies[3]), data(copies[4]), data(copies[5]),
            data(copies[6]), data(copies[7]),
        )
        self.ends, self.fastest, self.change, self.brake = (
            data(copies[8]), data(copies[9]), data(copies[10]), data(copies[11])
        )
        self.held = copies[5] if held else None
        self.chain, self.turn, self.threshold, self.serves = chain, turn, threshold, serves
        self.objective = objective
        self.reference, self.endless, self.period, self.jump = reference, endless, period, jump
        self.most_lag, self.solved, self.most_steps = most_lag, solved, most_steps

    def __call__(self, double t, state, measured, target, target_ahead, asked, more, v_d, objective):
        """State after the step; None where it is not ordinary.

        Args:
            t: Time.
            state: State before, a `KinematicState`.
            measured: Measured joints.
            target, target_ahead: Task points asked for now and a period later.
            asked: Acceleration asked of v, (r,); None where v is held.
            more: Further acceleration asked of v, (r,), or None.
            v_d, objective: Target of the self-motion, and whose it is, for the next step; not where v is held.
        """
        cdef int n = self.n, m = self.m, r = n - m, i, j, k
        cdef double h = self.period, lag = 0.0, away, left, total, v, moved, pace, behind, last
        cdef double p[MOST_JOINTS]
        cdef double least[MOST_JOINTS]
        cdef double most[MOST_JOINTS]
        cdef double point[12 * MOST_PARTS]
        cdef double goal[12 * MOST_PARTS]
        cdef double e[MOST_ROWS]
        cdef double e_before[MOST_ROWS]
        (then, joints, velocities, before, point_now, on, _, _, _, point_before, target_before, reference, _, whose,
         speed, delay) = <tuple>state
        if asked is None:
            if whose is not self.objective or self.held is None:
                return None
            v_d, objective = self.held, self.objective
        elif not plain(asked, r):
            return None
        if more is not None and not plain(more, r):
            return None
        if reference is not self.reference or not (
            plain(measured, n) and plain(joints, n) and plain(velocities, n) and plain(before, n)
        ):
            return None
        for z in (target, target_ahead, point_now, point_before, target_before):
            if not plain(z, self.chain.size):
                return None
        cdef double *q = data(joints)
        cdef double *u = data(velocities)
        cdef cnp.ndarray seen = empty(n), q_next = empty(n), u_next = empty(n)
        cdef cnp.ndarray z_next = empty(self.chain.size), deficit = empty(m)
        for j in range(n):
            total = data(measured)[j]
            if self.continuous[j] != 0.0:
                total -= TAU * rint((total - q[j]) / TAU)
                if not fabs(q[j] - self.q_bar[j]) < self.turn:
                    return None
            data(seen)[j], away = total, fabs(total - q[j])
            if not (fabs(total - data(before)[j]) <= self.jump + 2.0 * fabs(u[j]) * h and away <= self.most_lag):
                return None
            lag = max(lag, away)
            least[j] = -self.largest(n + j, -q[j], -u[j])
            most[j] = self.largest(j, q[j], u[j])
            p[j] = q[j] + h * u[j]
        # The goal, and the accelerations that lead there.
        self.chain.difference(data(point_now), data(target), e)
        self.chain.difference(data(point_before), data(target_before), e_before)
        for i in range(m):
            e[i] = self.a1[i] * e[i] - self.a2[i] * e_before[i]
        advance(self.chain, data(target_ahead), e, goal)
        self.chain.evaluate(p, point, self.J)
        self.chain.difference(goal, point, e)
        for i in range(m):
            self.F[i] = e[i] / (h * h)
        for k in range(r):
            if asked is not None:
                self.F[m + k] = data(asked)[k]
            else:
                v, moved = dot(self.Wt + k * n, q, n) + self.v_zero[k], h * dot(self.Wt + k * n, u, n)
                left = self.b1[k] * (self.v_d[k] - v) - self.b2[k] * (self.v_d[k] - v + moved)
                self.F[m + k] = (self.v_d[k] - left - v - moved) / (h * h)
            if more is not None:
                self.F[m + k] += data(more)[k]
        status, found, margin = <tuple>self.solve(u)
        if status != DONE:
            return None
        if not margin > self.threshold and not self.serves(self.kept[2].reshape(m, n)):
            return None
        for j in range(n):
            total = u[j] + h * data(found)[j]
            if not least[j] <= total <= most[j]:
                return None
            data(q_next)[j] = p[j] + h * h * data(found)[j]
        # Newton's method; the map's inverse serves once more.
        for k in range(self.most_steps + 1):
            self.chain.evaluate(data(q_next), data(z_next), NULL)
            self.chain.difference(goal, data(z_next), e)
            if k == self.most_steps or dot(e, e, m) <= self.solved:
                break
            for i in range(m):
                total = 0.0
                for j in range(m):
                    total += self.A[i + m * j] * e[j]
                for j in range(n):
                    data(q_next)[j] += self.Qt[i * n + j] * total
        for j in range(n):
            total = (data(q_next)[j] - q[j]) / h
            if not least[j] <= total <= most[j]:
                return None
            data(u_next)[j] = total
        for i in range(m):
            data(deficit)[i] = e[i] / (h * h)
        last, pace, behind = then, speed, delay
        behind += (1.0 - pace) * (t - last)
        return named(type(state), (
            t, q_next, u_next, seen, z_next, on, deficit, False, lag, point_now, target, reference, v_d, objective,
            pace, behind,
        ))

    cdef double largest(self, int way, double q, double u) noexcept nogil:
        """`VelocityBox` for one way of one joint: its largest velocity, upwards or, of −q, downwards."""
        cdef double h = self.period, room = min(self.ends[way] - q, self.endless), b = self.brake[way], k, most
        # A limit that is passed is left to the loop.
        if room < 0.0:
            return -INFINITY
        k = floor(0.5 * (sqrt(1.0 + 8.0 * room / (h * b)) - 1.0))
        most = (room / h + 0.5 * b * k * (k + 1.0)) / (k + 1.0)
        return min(min(most, self.fastest[way]), u + self.change[way])


cdef void advance(Chain chain, const double* z, const double* e, double* out) noexcept nogil:
    """Point reached from z by the step e."""
    cdef int k, i
    for k in range(chain.parts):
        if chain.part_kind[k] == ORIENTATION:
            rotate(e, z, out)
        elif chain.part_kind[k] == AXIS:
            follow_arc(z, e, out)
        else:
            for i in range(min(chain.part_size[k], 3)):
                out[i] = z[i] + e[i]
            if chain.part_kind[k] == POSE:
                rotate(&e[3], &z[3], &out[3])
        z += chain.part_size[k]
        out += chain.part_size[k]
        e += chain.part_rows[k]
