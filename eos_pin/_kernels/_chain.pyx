# cython: language_level=3, boundscheck=False, wraparound=False, cdivision=True, initializedcheck=False
"""Kinematics of a tree of joints on plain arrays, and a search for joints at a task point.

Every joint moves along or about the z axis of its own frame, so that a rotation touches two columns only. A placement is
12 numbers, the rotation row by row and the position; a task point has the order of `eos_pin.tasks.base`.
"""

from libc.math cimport INFINITY, atan2, cos, fabs, isfinite, remainder, sin, sqrt
from libc.string cimport memcpy, memset

from eos_pin._kernels._turns cimport arc, rotation_vector, tangents

import numpy as np

from eos_pin._kernels import plain

#: As in the plain form.
cdef double DAMPING = plain.DAMPING, FLOOR = plain.FLOOR, LONGEST = plain.LONGEST
cdef int PATIENCE = plain.PATIENCE

cdef double TAU = 6.283185307179586
#: Most joints and most coordinates of a task that the kernels take.
LARGEST = MOST_JOINTS, MOST_ROWS


cdef inline void compose(const double* A, const double* B, double* C) noexcept nogil:
    """C = A B for placements; C is neither of the two."""
    cdef int i, j
    for i in range(3):
        for j in range(3):
            C[3 * i + j] = A[3 * i] * B[j] + A[3 * i + 1] * B[3 + j] + A[3 * i + 2] * B[6 + j]
        C[9 + i] = A[9 + i] + A[3 * i] * B[9] + A[3 * i + 1] * B[10] + A[3 * i + 2] * B[11]


cdef class Chain:
    """Joints of a robot and the frames of a task.

    Args:
        parents: Number of each joint's parent, −1 for the base, (n,).
        prismatic: Whether each joint slides, (n,).
        fixed: Placement of each joint in its parent's frame where it is at zero, (n, 12).
        joints: Joint that carries the frame of each part of the task, −1 for the base, (k,).
        kinds: Kind of each part, (k,).
        axes: Coordinates of the position that count, −1 for none, (k, 3).
        tips: Placement of each part's frame in that joint's frame, (k, 12).
    """

    def __init__(self, parents, prismatic, fixed, joints, kinds, axes, tips):
        cdef int i, k, j
        cdef set used = set()
        self.n, self.parts = len(parents), len(joints)
        if self.n > MOST_JOINTS or self.parts > MOST_PARTS:
            raise ValueError(f"at most {MOST_JOINTS} joints and {MOST_PARTS} parts of a task are possible")
        for i in range(self.n):
            self.parent[i], self.prismatic[i] = parents[i], prismatic[i]
            for j in range(12):
                self.fixed[12 * i + j] = fixed[i][j]
        memset(self.moves, 0, sizeof(self.moves))
        for k in range(self.parts):
            self.part_joint[k], self.part_kind[k] = joints[k], kinds[k]
            for j in range(12):
                self.tips[12 * k + j] = tips[k][j]
            count = sum(axis >= 0 for axis in axes[k])
            for j in range(3):
                self.part_axes[3 * k + j] = axes[k][j]
            self.part_rows[k] = {POSITION: count, ORIENTATION: 3, POSE: 6, HEADING: 1, AXIS: 2}[kinds[k]]
            self.part_size[k] = {POSITION: count, ORIENTATION: 9, POSE: 12, HEADING: 1, AXIS: 3}[kinds[k]]
            self.m += self.part_rows[k]
            self.size += self.part_size[k]
            i = joints[k]
            while i >= 0:
                self.moves[k * MOST_JOINTS + i] = 1
                used.add(i)
                i = parents[i]
        if self.m > MOST_ROWS:
            raise ValueError(f"at most {MOST_ROWS} coordinates of a task are possible")
        for i in sorted(used):
            self.active[self.active_count] = i
            self.active_count += 1

    cdef void place(self, const double* q, double* world, bint everything) noexcept nogil:
        """Placement of each joint's frame in the world; of those that move the task, or of all."""
        cdef int i, k, row, count = self.n if everything else self.active_count
        cdef double c, s, a, b
        cdef double* W
        for k in range(count):
            i = k if everything else self.active[k]
            W = &world[12 * i]
            if self.parent[i] < 0:
                memcpy(W, &self.fixed[12 * i], 12 * sizeof(double))
            else:
                compose(&world[12 * self.parent[i]], &self.fixed[12 * i], W)
            if self.prismatic[i]:
                for row in range(3):
                    W[9 + row] += q[i] * W[3 * row + 2]
            else:
                c, s = cos(q[i]), sin(q[i])
                for row in range(3):
                    a, b = W[3 * row], W[3 * row + 1]
                    W[3 * row], W[3 * row + 1] = c * a + s * b, c * b - s * a

    cdef void evaluate(self, const double* q, double* z, double* J) noexcept nogil:
        """Task point, and the Jacobian row by row where there is room for it."""
        cdef double world[12 * MOST_JOINTS]
        cdef double T[12]
        cdef double column[6]
        cdef double E[6]
        cdef double x, y, w
        cdef double* W
        cdef int k, i, a, row, first = 0
        self.place(q, world, False)
        for k in range(self.parts):
            if self.part_joint[k] < 0:
                memcpy(T, &self.tips[12 * k], 12 * sizeof(double))
            else:
                compose(&world[12 * self.part_joint[k]], &self.tips[12 * k], T)
            if self.part_kind[k] == POSITION:
                for row in range(self.part_rows[k]):
                    z[row] = T[9 + self.part_axes[3 * k + row]]
            elif self.part_kind[k] == ORIENTATION:
                memcpy(z, T, 9 * sizeof(double))
            elif self.part_kind[k] == POSE:
                memcpy(z, &T[9], 3 * sizeof(double))
                memcpy(&z[3], T, 9 * sizeof(double))
            elif self.part_kind[k] == AXIS:
                w = 1.0 / sqrt(T[2] * T[2] + T[5] * T[5] + T[8] * T[8])
                z[0], z[1], z[2] = w * T[2], w * T[5], w * T[8]
                tangents(z, E)
            else:
                z[0] = atan2(T[3], T[0])
            z += self.part_size[k]
            if J == NULL:
                continue
            for i in range(self.n):
                if not self.moves[k * MOST_JOINTS + i]:
                    for row in range(self.part_rows[k]):
                        J[(first + row) * self.n + i] = 0.0
                    continue
                W = &world[12 * i]
                if self.prismatic[i]:
                    for a in range(3):
                        column[a], column[3 + a] = W[3 * a + 2], 0.0
                else:
                    x, y, w = T[9] - W[9], T[10] - W[10], T[11] - W[11]
                    column[3], column[4], column[5] = W[2], W[5], W[8]
                    column[0] = W[5] * w - W[8] * y
                    column[1] = W[8] * x - W[2] * w
                    column[2] = W[2] * y - W[5] * x
                if self.part_kind[k] == AXIS:
                    # Velocity ω × a along e1 and e2 = a × e1.
                    x = E[3] * column[3] + E[4] * column[4] + E[5] * column[5]
                    y = E[0] * column[3] + E[1] * column[4] + E[2] * column[5]
                    J[first * self.n + i], J[(first + 1) * self.n + i] = x, -y
                    continue
                for row in range(self.part_rows[k]):
                    if self.part_kind[k] == POSITION:
                        a = self.part_axes[3 * k + row]
                    elif self.part_kind[k] == ORIENTATION:
                        a = 3 + row
                    elif self.part_kind[k] == POSE:
                        a = row
                    else:
                        a = 5
                    J[(first + row) * self.n + i] = column[a]
            first += self.part_rows[k]

    cdef void difference(self, const double* z1, const double* z0, double* e) noexcept nogil:
        """Step from z0 to z1."""
        cdef int k, i
        for k in range(self.parts):
            if self.part_kind[k] == ORIENTATION:
                rotation_vector(z1, z0, e)
            elif self.part_kind[k] == HEADING:
                e[0] = remainder(z1[0] - z0[0], TAU)
            elif self.part_kind[k] == AXIS:
                arc(z1, z0, e)
            else:
                for i in range(min(self.part_size[k], 3)):
                    e[i] = z1[i] - z0[i]
                if self.part_kind[k] == POSE:
                    rotation_vector(&z1[3], &z0[3], &e[3])
            z1 += self.part_size[k]
            z0 += self.part_size[k]
            e += self.part_rows[k]

    cdef int descend(
        self, double* q, const double* z, const double* lower, const double* upper, double tol, int most, double* left
    ) noexcept nogil:
        """`eos_pin._kernels.plain.descend`: moves q; the number of steps, and the task error that is left."""
        cdef double point[12 * MOST_PARTS]
        cdef double J[MOST_ROWS * MOST_JOINTS]
        cdef double J_ahead[MOST_ROWS * MOST_JOINTS]
        cdef double A[MOST_ROWS * MOST_ROWS]
        cdef double e[MOST_ROWS]
        cdef double e_ahead[MOST_ROWS]
        cdef double x[MOST_ROWS]
        cdef double step[MOST_JOINTS]
        cdef double ahead[MOST_JOINTS]
        cdef bint free[MOST_JOINTS]
        cdef int n = self.n, m = self.m, i, j, k, slow = 0, iteration = 0
        cdef double square = 0.0, square_ahead, mu = DAMPING, total, longest, worst = 0.0, worst_ahead
        for i in range(n):
            q[i] = min(max(q[i], lower[i]), upper[i])
        self.evaluate(q, point, J)
        self.difference(z, point, e)
        for i in range(m):
            square += e[i] * e[i]
            worst = max(worst, fabs(e[i]))
        if not isfinite(square):
            left[0] = INFINITY
            return 0
        while worst > tol and iteration < most and slow < PATIENCE:
            iteration += 1
            for j in range(n):
                free[j] = True
                if q[j] <= lower[j] or q[j] >= upper[j]:
                    total = 0.0
                    for i in range(m):
                        total += J[i * n + j] * e[i]
                    free[j] = not (q[j] <= lower[j] and total < 0.0 or q[j] >= upper[j] and total > 0.0)
            for i in range(m):
                for k in range(i + 1):
                    total = 0.0
                    for j in range(n):
                        if free[j]:
                            total += J[i * n + j] * J[k * n + j]
                    A[i * m + k] = total
                A[i * m + i] += mu * square + FLOOR
            if not solve(A, e, x, m):
                break
            longest = 0.0
            for j in range(n):
                step[j] = 0.0
                if free[j]:
                    for i in range(m):
                        step[j] += J[i * n + j] * x[i]
                longest = max(longest, fabs(step[j]))
            for j in range(n):
                if longest > LONGEST:
                    step[j] *= LONGEST / longest
                ahead[j] = min(max(q[j] + step[j], lower[j]), upper[j])
            self.evaluate(ahead, point, J_ahead)
            self.difference(z, point, e_ahead)
            square_ahead, worst_ahead = 0.0, 0.0
            for i in range(m):
                square_ahead += e_ahead[i] * e_ahead[i]
                worst_ahead = max(worst_ahead, fabs(e_ahead[i]))
            slow = 0 if square_ahead < 0.9 * square else slow + 1
            if square_ahead < square:
                memcpy(q, ahead, n * sizeof(double))
                memcpy(J, J_ahead, m * n * sizeof(double))
                memcpy(e, e_ahead, m * sizeof(double))
                square, worst, mu = square_ahead, worst_ahead, 0.25 * mu
            else:
                mu *= 8.0
        left[0] = worst
        return iteration

    # -- the same on arrays ------------------------------------------------------------------------------------------

    def value(self, const double[:, ::1] Q):
        """Task points, (K, size)."""
        Z = np.empty((Q.shape[0], self.size))
        cdef double[:, ::1] z = Z
        cdef Py_ssize_t k
        with nogil:
            for k in range(Q.shape[0]):
                self.evaluate(&Q[k, 0], &z[k, 0], NULL)
        return Z

    def linearize(self, const double[:, ::1] Q):
        """Task points, (K, size), and Jacobians, (K, m, n)."""
        Z, JJ = np.empty((Q.shape[0], self.size)), np.empty((Q.shape[0], self.m, self.n))
        cdef double[:, ::1] z = Z
        cdef double[:, :, ::1] J = JJ
        cdef Py_ssize_t k
        with nogil:
            for k in range(Q.shape[0]):
                self.evaluate(&Q[k, 0], &z[k, 0], &J[k, 0, 0])
        return Z, JJ

    def minus(self, const double[:, ::1] Z1, const double[:, ::1] Z0):
        """Steps from Z0 to Z1, (K, m); either may have one row for all."""
        cdef Py_ssize_t k, count = max(Z1.shape[0], Z0.shape[0]), one = Z1.shape[0] > 1, other = Z0.shape[0] > 1
        E = np.empty((count, self.m))
        cdef double[:, ::1] e = E
        with nogil:
            for k in range(count):
                self.difference(&Z1[k * one, 0], &Z0[k * other, 0], &e[k, 0])
        return E

    def search(self, const double[:, ::1] Q, const double[:, ::1] Z, const double[::1] lower, const double[::1] upper,
               double tol, int most, bint first):
        """Search from each row of Q for the task point in the same row of Z, or in its only one.

        With `first` the search ends at the first that is found. The joints, task errors and steps of those tried.
        """
        found = np.array(Q)
        left, steps = np.empty(Q.shape[0]), np.empty(Q.shape[0], dtype=np.int64)
        cdef double[:, ::1] q = found
        cdef double[::1] residual = left
        cdef long long[::1] taken = steps
        cdef Py_ssize_t k, tried = Q.shape[0], several = Z.shape[0] > 1
        with nogil:
            for k in range(Q.shape[0]):
                taken[k] = self.descend(&q[k, 0], &Z[k * several, 0], &lower[0], &upper[0], tol, most, &residual[k])
                if first and residual[k] <= tol:
                    tried = k + 1
                    break
        return found[:tried], left[:tried], steps[:tried]

    def one(self, const double[::1] q, const double[::1] z, const double[::1] lower, const double[::1] upper, double tol,
            int most):
        """Search from one state: joints and the task error that is left."""
        found = np.empty(self.n)
        cdef double[::1] x = found
        cdef double left
        memcpy(&x[0], &q[0], self.n * sizeof(double))
        self.descend(&x[0], &z[0], &lower[0], &upper[0], tol, most, &left)
        return found, left

    def links(self, const double[:, ::1] Q, const int[::1] joints, const double[:, ::1] placements):
        """Flat poses of frames, each fixed to a joint or, by −1, to the base, (K, L, 12)."""
        P = np.empty((Q.shape[0], joints.shape[0], 12))
        cdef double[:, :, ::1] poses = P
        cdef double world[12 * MOST_JOINTS]
        cdef double T[12]
        cdef Py_ssize_t k, i
        with nogil:
            for k in range(Q.shape[0]):
                self.place(&Q[k, 0], world, True)
                for i in range(joints.shape[0]):
                    if joints[i] < 0:
                        memcpy(T, &placements[i, 0], sizeof(T))
                    else:
                        compose(&world[12 * joints[i]], &placements[i, 0], T)
                    memcpy(&poses[k, i, 0], &T[9], 3 * sizeof(double))
                    memcpy(&poses[k, i, 3], T, 9 * sizeof(double))
        return P


cdef inline bint solve(double* A, const double* b, double* x, int m) noexcept nogil:
    """x of A x = b by Cholesky's method, the lower half of A in place; False where A is not positive definite."""
    cdef int i, j, k
    cdef double total
    for i in range(m):
        for j in range(i + 1):
            total = A[i * m + j]
            for k in range(j):
                total -= A[i * m + k] * A[j * m + k]
            if i == j:
                if not total > 0.0 or not isfinite(total):
                    return False
                A[i * m + i] = sqrt(total)
            else:
                A[i * m + j] = total / A[j * m + j]
    for i in range(m):
        total = b[i]
        for k in range(i):
            total -= A[i * m + k] * x[k]
        x[i] = total / A[i * m + i]
    for i in range(m - 1, -1, -1):
        total = x[i]
        for k in range(i + 1, m):
            total -= A[k * m + i] * x[k]
        x[i] = total / A[i * m + i]
    return True
