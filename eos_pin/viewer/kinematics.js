/** Kinematics of a robot in the page: the chain, its task, and charts y(z, v). The formulas are those of the Python package.
 *
 * A placement is 12 numbers, the rotation row by row and the position. Every joint moves along or about the z axis of its own
 * frame. Matrices are flat arrays, row by row; J is m × n, U is n × m, V is n × r.
 */
"use strict";
const Kinematics = (() => {
  const POSITION = 0, ORIENTATION = 1, POSE = 2, HEADING = 3, AXIS = 4;
  /** A chart is left where its margin falls below this, as in Python. */
  const THRESHOLD = .5;
  /** Task error that is left, longest change of a joint in one step of a walk, and shortest such step. */
  const TOLERANCE = 1e-12, LONGEST = .25, SHORTEST = 1e-3;

  // -- small matrices --------------------------------------------------------------------------------------------------
  /** A B, for A of size p × q and B of size q × s. */
  function times(A, B, p, q, s) {
    const C = new Float64Array(p * s);
    for (let i = 0; i < p; i++) for (let k = 0; k < q; k++) {
      const x = A[i * q + k];
      if (x) for (let j = 0; j < s; j++) C[i * s + j] += x * B[k * s + j];
    }
    return C;
  }
  function transposed(A, p, q) {
    const B = new Float64Array(p * q);
    for (let i = 0; i < p; i++) for (let j = 0; j < q; j++) B[j * p + i] = A[i * q + j];
    return B;
  }
  /** Solution X of A X = B, for A of size p × p and B of size p × s, and the determinant; null where A is singular. */
  function solve(A, B, p, s) {
    const L = Float64Array.from(A), X = Float64Array.from(B);
    let determinant = 1;
    for (let k = 0; k < p; k++) {
      let best = k;
      for (let i = k + 1; i < p; i++) if (Math.abs(L[i * p + k]) > Math.abs(L[best * p + k])) best = i;
      if (!(Math.abs(L[best * p + k]) > 0)) return null;
      if (best !== k) {
        determinant = -determinant;
        for (let j = 0; j < p; j++) [L[k * p + j], L[best * p + j]] = [L[best * p + j], L[k * p + j]];
        for (let j = 0; j < s; j++) [X[k * s + j], X[best * s + j]] = [X[best * s + j], X[k * s + j]];
      }
      determinant *= L[k * p + k];
      for (let i = k + 1; i < p; i++) {
        const factor = L[i * p + k] / L[k * p + k];
        if (!factor) continue;
        for (let j = k; j < p; j++) L[i * p + j] -= factor * L[k * p + j];
        for (let j = 0; j < s; j++) X[i * s + j] -= factor * X[k * s + j];
      }
    }
    for (let k = p - 1; k >= 0; k--) for (let j = 0; j < s; j++) {
      for (let i = k + 1; i < p; i++) X[k * s + j] -= L[k * p + i] * X[i * s + j];
      X[k * s + j] /= L[k * p + k];
    }
    return { X, determinant };
  }
  /** Eigenvalues of a symmetric matrix by Jacobi's method, the least first. */
  function eigenvalues(A, p) {
    const S = Float64Array.from(A);
    for (let sweep = 0; sweep < 30; sweep++) {
      let off = 0, all = 0;
      for (let i = 0; i < p; i++) for (let j = 0; j < p; j++) { all += S[i * p + j] ** 2; if (i !== j) off += S[i * p + j] ** 2; }
      if (off <= 1e-30 * all) break;
      for (let i = 0; i < p; i++) for (let j = i + 1; j < p; j++) {
        const b = S[i * p + j];
        if (!b) continue;
        const theta = (S[j * p + j] - S[i * p + i]) / (2 * b), t = (theta < 0 ? -1 : 1) / (Math.abs(theta) + Math.hypot(theta, 1));
        const c = 1 / Math.hypot(t, 1), s = t * c;
        for (let k = 0; k < p; k++) { const x = S[k * p + i], y = S[k * p + j]; S[k * p + i] = c * x - s * y; S[k * p + j] = s * x + c * y; }
        for (let k = 0; k < p; k++) { const x = S[i * p + k], y = S[j * p + k]; S[i * p + k] = c * x - s * y; S[j * p + k] = s * x + c * y; }
      }
    }
    return Float64Array.from({ length: p }, (_, i) => S[i * p + i]).sort();
  }
  /** Orthonormal basis of the row space of J, n × m, by Gram and Schmidt, each vector twice. */
  function rowBasis(J, m, n) {
    const Q = new Float64Array(n * m), x = new Float64Array(n);
    for (let k = 0; k < m; k++) {
      for (let i = 0; i < n; i++) x[i] = J[k * n + i];
      for (let again = 0; again < 2; again++) for (let l = 0; l < k; l++) {
        let dot = 0;
        for (let i = 0; i < n; i++) dot += Q[i * m + l] * x[i];
        for (let i = 0; i < n; i++) x[i] -= dot * Q[i * m + l];
      }
      const length = Math.hypot(...x);
      for (let i = 0; i < n; i++) Q[i * m + k] = x[i] / length;
    }
    return Q;
  }
  /** Lower factor L of A = L Lᵀ, p × p; null where A is not positive. */
  function cholesky(A, p) {
    const L = new Float64Array(p * p);
    for (let i = 0; i < p; i++) for (let j = 0; j <= i; j++) {
      let rest = A[i * p + j];
      for (let k = 0; k < j; k++) rest -= L[i * p + k] * L[j * p + k];
      if (i !== j) L[i * p + j] = rest / L[j * p + j];
      else if (rest > 0) L[i * p + i] = Math.sqrt(rest);
      else return null;
    }
    return L;
  }
  /** Basis of the null space beside Q that lies nearest to V: the polar factor of its projection (orthogonal Procrustes). */
  function carried(V, Q, n, m, r) {
    const projected = times(Q, times(transposed(Q, n, m), V, m, n, r), n, m, r);
    let X = V.map((value, i) => value - projected[i]);
    for (let round = 0; round < 100; round++) {
      const G = times(transposed(X, n, r), X, r, n, r);
      let worst = 0;
      for (let i = 0; i < r * r; i++) worst = Math.max(worst, Math.abs(G[i] - (i % (r + 1) === 0 ? 1 : 0)));
      if (worst < 1e-15) break;
      const Y = times(X, G, n, r, r);
      X = X.map((value, i) => 1.5 * value - .5 * Y[i]);
      if (worst < 1e-13 && round > 90) break;
    }
    return X;
  }

  // -- rotations -------------------------------------------------------------------------------------------------------
  /** Rotation vector of R1 R0ᵀ. */
  function difference(R1, R0) {
    const R = new Float64Array(9);
    for (let i = 0; i < 3; i++) for (let j = 0; j < 3; j++) for (let k = 0; k < 3; k++) R[3 * i + j] += R1[3 * i + k] * R0[3 * j + k];
    const w = [.5 * (R[7] - R[5]), .5 * (R[2] - R[6]), .5 * (R[3] - R[1])], sine = Math.hypot(...w);
    const cosine = .5 * (R[0] + R[4] + R[8] - 1), angle = Math.atan2(sine, cosine);
    if (cosine > -.9) return w.map(x => x * (sine > 1e-9 ? angle / sine : 1));
    // Near half a turn the axis is read off the symmetric part, its sense off the rest.
    const diagonal = [R[0], R[4], R[8]], k = diagonal.indexOf(Math.max(...diagonal));
    const axis = [0, 1, 2].map(i => i === k ? (R[4 * k] - cosine) / (1 - cosine) : .5 * (R[3 * i + k] + R[3 * k + i]) / (1 - cosine));
    const length = Math.hypot(...axis), sense = axis[0] * w[0] + axis[1] * w[1] + axis[2] * w[2] < 0 ? -1 : 1;
    return axis.map(x => sense * angle * x / length);
  }
  /** exp(w) R. */
  function turned(R, w) {
    const angle = Math.hypot(...w), a = angle > 1e-12 ? Math.sin(angle) / angle : 1, half = Math.sin(.5 * angle), b = angle > 1e-12 ? 2 * half * half / angle ** 2 : .5;
    const [x, y, z] = w, E = [
      1 - b * (y * y + z * z), b * x * y - a * z, b * x * z + a * y,
      b * x * y + a * z, 1 - b * (x * x + z * z), b * y * z - a * x,
      b * x * z - a * y, b * y * z + a * x, 1 - b * (x * x + y * y)];
    return Array.from(times(E, R, 3, 3, 3));
  }

  // -- directions ------------------------------------------------------------------------------------------------------
  /** Orthonormal basis of the plane normal to a direction, 2 × 3: that of the pole, carried along the great circle. */
  function basis(a, pole) {
    const [x, y, z] = times(a, pole, 1, 3, 3), square = x * x + y * y, c = z > 0 ? 1 / (1 + z) : square > 0 ? (1 - z) / square : 0;
    return times([1 - c * x * x, -c * x * y, -x, -c * x * y, 1 - c * y * y, -y], transposed(pole, 3, 3), 2, 3, 3);
  }
  /** Step on the sphere from a0 to a1. */
  function across(a1, a0, pole) {
    const t = times(basis(a0, pole), a1, 2, 3, 1), sine = Math.hypot(...t), angle = Math.atan2(sine, a0[0] * a1[0] + a0[1] * a1[1] + a0[2] * a1[2]);
    return sine > 0 ? Array.from(t, x => angle * x / sine) : [angle, 0];
  }
  /** Direction that a step from a leads to. */
  function tilted(a, delta, pole) {
    const angle = Math.hypot(...delta), along = times(delta, basis(a, pole), 1, 2, 3), ratio = angle > 1e-8 ? Math.sin(angle) / angle : 1;
    const ahead = a.map((x, i) => Math.cos(angle) * x + ratio * along[i]), length = Math.hypot(...ahead);
    return ahead.map(x => x / length);
  }

  // -- the robot and its task ------------------------------------------------------------------------------------------
  /** C = A B for placements of which A begins at a and C at c. */
  function compose(A, a, B, C, c) {
    for (let i = 0; i < 3; i++) {
      const x = A[a + 3 * i], y = A[a + 3 * i + 1], z = A[a + 3 * i + 2];
      for (let j = 0; j < 3; j++) C[c + 3 * i + j] = x * B[j] + y * B[3 + j] + z * B[6 + j];
      C[c + 9 + i] = A[a + 9 + i] + x * B[9] + y * B[10] + z * B[11];
    }
  }

  class Robot {
    /** @param data Arrays `parents`, `prismatic`, `fixed`, `parts` of joint, kind, axes and tip, `pole`; masses, centres, inertias, armature, gravity. */
    constructor(data) {
      Object.assign(this, data);
      this.n = this.parents.length;
      // Where each part begins in z and among the rows of J.
      let at = 0, row = 0;
      this.parts = this.parts.map(part => {
        const count = part.axes.length, rows = [count, 3, 6, 1, 2][part.kind], size = [count, 9, 12, 1, 3][part.kind];
        const made = { ...part, at, row, size, rows };
        at += size;
        row += rows;
        return made;
      });
      this.m = row;
      this.r = this.n - this.m;
      this.world = new Float64Array(12 * this.n);
      this.segments = new Float64Array(6 * this.capsules.carriers.length);
    }
    /** Placements of all joints. */
    place(q) {
      const world = this.world, turned = new Float64Array(12);
      for (let i = 0; i < this.n; i++) {
        const w = 12 * i, p = this.parents[i];
        if (p < 0) world.set(this.fixed[i], w);
        else { compose(world, 12 * p, this.fixed[i], turned, 0); world.set(turned, w); }
        if (this.prismatic[i]) for (let row = 0; row < 3; row++) world[w + 9 + row] += q[i] * world[w + 3 * row + 2];
        else {
          const c = Math.cos(q[i]), s = Math.sin(q[i]);
          for (let row = 0; row < 3; row++) {
            const a = world[w + 3 * row], b = world[w + 3 * row + 1];
            world[w + 3 * row] = c * a + s * b;
            world[w + 3 * row + 1] = c * b - s * a;
          }
        }
      }
      return world;
    }
    /** Placement of something that a joint carries, after `place`. */
    carried(joint, local) {
      const T = new Float64Array(12);
      if (joint < 0) T.set(local);
      else compose(this.world, 12 * joint, local, T, 0);
      return T;
    }
    /** Velocity of a point p that a joint carries, 6 × n: linear, then angular. */
    jacobianOf(joint, p) {
      const J = new Float64Array(6 * this.n), n = this.n, world = this.world;
      for (let i = joint; i >= 0; i = this.parents[i]) {
        const w = 12 * i, x = world[w + 2], y = world[w + 5], z = world[w + 8];
        if (this.prismatic[i]) { J[i] = x; J[n + i] = y; J[2 * n + i] = z; continue; }
        const a = p[0] - world[w + 9], b = p[1] - world[w + 10], c = p[2] - world[w + 11];
        J[i] = y * c - z * b; J[n + i] = z * a - x * c; J[2 * n + i] = x * b - y * a;
        J[3 * n + i] = x; J[4 * n + i] = y; J[5 * n + i] = z;
      }
      return J;
    }
    /** Task point z and Jacobian J. */
    evaluate(q) {
      this.place(q);
      const n = this.n, z = [], J = new Float64Array(this.m * n);
      for (const { joint, kind, axes, tip, row } of this.parts) {
        const T = this.carried(joint, tip), p = T.subarray(9, 12), all = this.jacobianOf(joint, p);
        if (kind === POSE) { z.push(...p, ...T.subarray(0, 9)); J.set(all, row * n); }
        else if (kind === ORIENTATION) { z.push(...T.subarray(0, 9)); J.set(all.subarray(3 * n), row * n); }
        else if (kind === HEADING) { z.push(Math.atan2(T[3], T[0])); J.set(all.subarray(5 * n), row * n); }
        else if (kind === AXIS) {
          const a = [T[2], T[5], T[8]], E = basis(a, this.pole);
          z.push(...a);
          // Velocity ω × a along e1 and e2 = a × e1.
          J.set(times([E[3], E[4], E[5], -E[0], -E[1], -E[2]], all.subarray(3 * n), 2, 3, n), row * n);
        } else axes.forEach((axis, i) => { z.push(p[axis]); J.set(all.subarray(axis * n, (axis + 1) * n), (row + i) * n); });
      }
      return { z, J };
    }
    /** Step that leads from z0 to z1. */
    minus(z1, z0) {
      return this.parts.flatMap(({ kind, at, size }) => {
        const a1 = Array.from(z1.slice(at, at + size)), a0 = Array.from(z0.slice(at, at + size)), delta = a1.map((x, i) => x - a0[i]);
        if (kind === POSE) return [...delta.slice(0, 3), ...difference(a1.slice(3), a0.slice(3))];
        if (kind === ORIENTATION) return difference(a1, a0);
        if (kind === AXIS) return across(a1, a0, this.pole);
        return kind === HEADING ? [delta[0] - 2 * Math.PI * Math.round(delta[0] / (2 * Math.PI))] : delta;
      });
    }
    /** Point reached from z by a step. */
    plus(z, delta) {
      return this.parts.flatMap(({ kind, at, size, row, rows }) => {
        const a = Array.from(z.slice(at, at + size)), d = Array.from(delta.slice(row, row + rows));
        if (kind === POSE) return [a[0] + d[0], a[1] + d[1], a[2] + d[2], ...turned(a.slice(3), d.slice(3))];
        if (kind === ORIENTATION) return turned(a, d);
        return kind === AXIS ? tilted(a, d, this.pole) : a.map((x, i) => x + d[i]);
      });
    }
    /** Step that leads from z to where the robot is, in the axes of the Jacobian there. */
    error(here, z) { return this.minus(z, here).map(x => -x); }
    /** Potential energy [J] and torques [N m or N] of gravity, after `place`. */
    gravityLoad() {
      const n = this.n, torque = new Float64Array(n), world = this.world, [gx, gy, gz] = this.gravity;
      const mass = Float64Array.from(this.masses), moment = new Float64Array(3 * n);
      let energy = 0;
      for (let i = n - 1; i >= 0; i--) {
        const w = 12 * i, c = this.centres[i];
        for (let k = 0; k < 3; k++) {
          const at = world[w + 9 + k] + world[w + 3 * k] * c[0] + world[w + 3 * k + 1] * c[1] + world[w + 3 * k + 2] * c[2];
          moment[3 * i + k] += this.masses[i] * at;
          energy -= this.masses[i] * at * this.gravity[k];
        }
        // What the joint carries in all: its mass and first moment.
        const M = mass[i], x = moment[3 * i] - M * world[w + 9], y = moment[3 * i + 1] - M * world[w + 10], z = moment[3 * i + 2] - M * world[w + 11];
        const ax = world[w + 2], ay = world[w + 5], az = world[w + 8];
        torque[i] = this.prismatic[i] ? -M * (ax * gx + ay * gy + az * gz)
          : -(ax * (y * gz - z * gy) + ay * (z * gx - x * gz) + az * (x * gy - y * gx));
        const p = this.parents[i];
        if (p >= 0) { mass[p] += M; for (let k = 0; k < 3; k++) moment[3 * p + k] += moment[3 * i + k]; }
      }
      return { energy, torque };
    }
    /** Mass matrix M, n × n, after `place`: composite rigid bodies, seen from the origin of the world. */
    mass() {
      const n = this.n, world = this.world, M = new Float64Array(n * n), cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
      const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2], masses = Float64Array.from(this.masses), moments = [], inertias = [], motions = [];
      for (let i = 0; i < n; i++) {
        const w = 12 * i, R = world.subarray(w, w + 9), p = world.subarray(w + 9, w + 12), axis = [R[2], R[5], R[8]], m = masses[i];
        const c = times(R, this.centres[i], 3, 3, 1).map((x, k) => x + p[k]), I = times(times(R, this.inertias[i], 3, 3, 3), transposed(R, 3, 3), 3, 3, 3);
        for (let a = 0; a < 3; a++) for (let b = 0; b < 3; b++) I[3 * a + b] += m * ((a === b ? dot(c, c) : 0) - c[a] * c[b]);
        moments.push(c.map(x => m * x));
        inertias.push(I);
        motions.push(this.prismatic[i] ? { turn: [0, 0, 0], way: axis } : { turn: axis, way: cross(p, axis) });
      }
      for (let i = n - 1; i >= 0; i--) {
        const { turn, way } = motions[i], own = cross(turn, moments[i]), about = cross(moments[i], way), spin = times(inertias[i], turn, 3, 3, 1);
        const push = own.map((x, k) => x + masses[i] * way[k]), moment = about.map((x, k) => x + spin[k]);
        for (let j = i; j >= 0; j = this.parents[j]) M[i * n + j] = M[j * n + i] = dot(motions[j].turn, moment) + dot(motions[j].way, push);
        M[i * (n + 1)] += this.armature[i];
        const p = this.parents[i];
        if (p < 0) continue;
        masses[p] += masses[i];
        for (let k = 0; k < 3; k++) moments[p][k] += moments[i][k];
        for (let k = 0; k < 9; k++) inertias[p][k] += inertias[i][k];
      }
      return M;
    }
    /** Inertial coupling of z and v on the chart that is based where the robot is, after `place`; NaN where M is not positive.
     *
     * The cosine, in the metric M, of the least angle between the motions along Jᵀ and those that leave the task at rest.
     */
    coupling(J) {
      const { m, n } = this, L = cholesky(this.mass(), n);
      if (!L) return NaN;
      // Where M is the identity, motions along Jᵀ are Lᵀ Jᵀ, and those at rest are normal to the rows of J L⁻ᵀ.
      const task = rowBasis(times(J, L, m, n, n), m, n), rest = rowBasis(transposed(solve(L, transposed(J, m, n), n, m).X, n, m), m, n);
      const inside = times(rest, times(transposed(rest, n, m), task, m, n, m), n, m, m), left = task.map((x, i) => x - inside[i]);
      return Math.sqrt(Math.max(eigenvalues(times(transposed(left, n, m), left, m, n, m), m)[m - 1], 0));
    }
    /** Least distance of two of the robot's capsules [m], Infinity where none are known; after `place`. */
    clearance() {
      const { carriers, ends, radii, pairs } = this.capsules, world = this.world, at = this.segments;
      carriers.forEach((joint, i) => {
        for (let e = 0; e < 2; e++) {
          const [x, y, z] = ends[i][e], to = 6 * i + 3 * e, w = 12 * joint;
          if (joint < 0) { at[to] = x; at[to + 1] = y; at[to + 2] = z; continue; }
          for (let k = 0; k < 3; k++) at[to + k] = world[w + 9 + k] + world[w + 3 * k] * x + world[w + 3 * k + 1] * y + world[w + 3 * k + 2] * z;
        }
      });
      let least = Infinity;
      for (const [i, j] of pairs) least = Math.min(least, segments(at, 6 * i, 6 * j) - radii[i] - radii[j]);
      return least;
    }
    /** Square root of det(J Jᵀ), and the ratio of the smallest singular value to the largest. */
    manipulability(J) {
      const values = eigenvalues(times(J, transposed(J, this.m, this.n), this.m, this.n, this.m), this.m).map(x => Math.max(x, 0));
      return { value: Math.sqrt(values.reduce((a, b) => a * b, 1)), ratio: Math.sqrt(values[0] / values[this.m - 1]) };
    }
  }

  /** Distance of two segments, whose ends are six numbers that begin at i and at j. */
  function segments(at, i, j) {
    const wx = at[i] - at[j], wy = at[i + 1] - at[j + 1], wz = at[i + 2] - at[j + 2];
    const ux = at[i + 3] - at[i], uy = at[i + 4] - at[i + 1], uz = at[i + 5] - at[i + 2];
    const vx = at[j + 3] - at[j], vy = at[j + 4] - at[j + 1], vz = at[j + 5] - at[j + 2];
    const a = ux * ux + uy * uy + uz * uz, b = ux * vx + uy * vy + uz * vz, c = vx * vx + vy * vy + vz * vz;
    const d = ux * wx + uy * wy + uz * wz, e = vx * wx + vy * wy + vz * wz, D = a * c - b * b;
    let s = D > 1e-12 * a * c ? clamp((b * e - c * d) / D) : 0;
    const t = c > 1e-18 ? clamp((b * s + e) / c) : 0;
    s = a > 1e-18 ? clamp((b * t - d) / a) : 0;
    return Math.hypot(wx + s * ux - t * vx, wy + s * uy - t * vy, wz + s * uz - t * vz);
  }
  const clamp = x => Math.min(Math.max(x, 0), 1);

  /** Largest difference of a joint. */
  const apart = (q, other) => q.reduce((most, x, i) => Math.max(most, Math.abs(x - other[i])), 0);
  /** Go the way from 0 to 1 in steps as long as `visit` succeeds with: the part that was reached. */
  function walk(visit) {
    let reached = 0, step = 1;
    while (reached < 1 && step >= SHORTEST) {
      const ahead = Math.min(1, reached + step), good = visit(ahead);
      if (good) reached = ahead;
      step *= good ? 2 : .5;
    }
    return reached;
  }

  // -- charts ----------------------------------------------------------------------------------------------------------
  /** A neighbourhood of q on which (z, v) are coordinates; V and v go on from the previous chart. */
  class Chart {
    constructor(robot, q, V, v) {
      const { z, J } = robot.evaluate(q), { m, n } = robot;
      Object.assign(this, { robot, q: Float64Array.from(q), z, v: Float64Array.from(v), V });
      this.U = transposed(J, m, n);
      this.rows = rowBasis(J, m, n);
    }
    /** The chart at q that follows this one. */
    next(q) {
      const { m, n, r } = this.robot, { J } = this.robot.evaluate(q);
      return new Chart(this.robot, q, carried(this.V, rowBasis(J, m, n), n, m, r), this.at(q));
    }
    /** Self-motion coordinates v_bar + Vᵀ(q − q_bar); Eq. (11). */
    at(q) {
      const { n, r } = this.robot, v = Float64Array.from(this.v);
      for (let i = 0; i < n; i++) for (let k = 0; k < r; k++) v[k] += this.V[i * r + k] * (q[i] - this.q[i]);
      return v;
    }
    /** Coordinates along U: −(UᵀU)⁻¹Uᵀ(q − q_bar). */
    u(q) {
      const { m, n } = this.robot, Ut = transposed(this.U, n, m);
      return solve(times(Ut, this.U, m, n, m), times(Ut, this.q.map((x, i) => x - q[i]), m, n, 1), m, 1).X;
    }
    /** Cosine of the largest principal angle between the row spaces of J and of the base point; 0 on the edge. */
    margin(J) {
      const { m, n } = this.robot, cosines = times(transposed(rowBasis(J, m, n), n, m), this.rows, m, n, m);
      return Math.sqrt(Math.max(eigenvalues(times(cosines, transposed(cosines, m, m), m, m, m), m)[0], 0));
    }
    /** B = (J U)⁻¹, Eq. (15); null beyond the edge of the chart. */
    B(J) {
      const { m, n } = this.robot, I = new Float64Array(m * m);
      for (let i = 0; i < m; i++) I[i * (m + 1)] = 1;
      const found = solve(times(J, this.U, m, n, m), I, m, m);
      return found && found.determinant > 0 ? found.X : null;
    }
    /** D = (I − U B G')V, Eq. (16): velocities of joints for those of v while z rests. */
    D(J) {
      const { m, n, r } = this.robot, B = this.B(J);
      const less = times(this.U, times(B, times(J, this.V, m, n, r), m, m, r), n, m, r);
      return this.V.map((value, i) => value - less[i]);
    }
    /** Joints y(z, v) by Newton's method from coordinates u, Eqs. (13), (22); null where it does not converge. */
    inverse(z, v, u) {
      const { robot } = this, { m, n, r } = robot, base = Float64Array.from(this.q);
      for (let i = 0; i < n; i++) for (let k = 0; k < r; k++) base[i] += this.V[i * r + k] * (v[k] - this.v[k]);
      u = Float64Array.from(u);
      let last = Infinity;
      for (let iteration = 0; iteration <= 20; iteration++) {
        const q = Float64Array.from(base);
        for (let i = 0; i < n; i++) for (let k = 0; k < m; k++) q[i] -= this.U[i * m + k] * u[k];
        const { z: here, J } = robot.evaluate(q), error = robot.error(here, z);
        const residual = Math.max(...error.map(Math.abs));
        const B = this.B(J);
        if (!B) return null;
        // At the limit of rounding the residual no longer falls.
        if (residual <= TOLERANCE || residual <= 1e3 * TOLERANCE && residual >= last) return { q, u, J, residual };
        if (!(residual < last)) return null;
        last = residual;
        const step = times(B, error, m, m, 1);
        for (let k = 0; k < m; k++) u[k] += step[k];
      }
      return null;
    }
    /** Joints y(z, v), where need be by a walk along the straight line from the base point; null where the chart ends before. */
    reach(z, v) {
      const { robot } = this, delta = robot.minus(z, this.z);
      let found = { q: this.q, u: new Float64Array(robot.m) };
      const part = walk(ahead => {
        const next = this.inverse(ahead === 1 ? z : robot.plus(this.z, delta.map(x => ahead * x)), this.v.map((x, i) => x + ahead * (v[i] - x)), found.u);
        // Newton's method may find another posture with the same z and v; the near one is connected.
        const good = next && apart(next.q, found.q) <= LONGEST;
        if (good) found = next;
        return good;
      });
      return part < 1 ? null : found;
    }
  }

  /** A posture that moves in (z, v) from chart to chart. */
  class Posture {
    constructor(robot, q, V) {
      this.robot = robot;
      this.charts = 1;
      this.chart = new Chart(robot, q, Float64Array.from(V), new Float64Array(robot.r));
      this.settle(this.chart.q, new Float64Array(robot.m));
    }
    settle(q, u) {
      const { z, J } = this.robot.evaluate(q);
      Object.assign(this, { q: Float64Array.from(q), u, J, z, v: this.chart.at(q) });
      this.margin = this.chart.margin(J);
      if (this.margin < THRESHOLD) this.rebase();
    }
    /** A chart based where the posture is. */
    rebase() {
      this.chart = this.chart.next(this.q);
      this.charts++;
      Object.assign(this, { u: new Float64Array(this.robot.m), margin: 1, v: Float64Array.from(this.chart.v) });
    }
    /** Go on the straight line to (z, v), as far as the robot can: the part of the way that was reached. */
    moveTo(z, v) {
      const { robot } = this, z0 = this.z, v0 = this.v, delta = robot.minus(z, z0);
      return walk(ahead => {
        const goal = ahead === 1 ? z : robot.plus(z0, delta.map(x => ahead * x)), target = v0.map((x, i) => x + ahead * (v[i] - x));
        const found = this.chart.inverse(goal, target, this.u);
        if (!found || apart(found.q, this.q) > LONGEST || this.chart.margin(found.J) < .3) return false;
        this.settle(found.q, found.u);
        // The last point that was asked for, lest rounding gather from move to move.
        this.z = goal;
        return true;
      });
    }
    /** Jump to other joints; v starts anew at zero. */
    jump(q) {
      this.chart = this.chart.next(q);
      this.chart.v.fill(0);
      this.settle(q, new Float64Array(this.robot.m));
    }
    /** Difference between the task point and where the robot is [m, rad]. */
    error(z = this.z) { return Math.max(...this.robot.minus(this.robot.evaluate(this.q).z, z).map(Math.abs)); }
    /** Turn v so that a point which a joint carries comes close to a place, z at rest. */
    pull(joint, local, place) {
      const { robot } = this, { n, r } = robot, z = this.z;
      for (let round = 0; round < 8; round++) {
        const { J } = robot.evaluate(this.q), p = robot.carried(joint, local).subarray(9, 12);
        const away = place.map((x, i) => x - p[i]);
        const A = times(robot.jacobianOf(joint, p).slice(0, 3 * n), this.chart.D(J), 3, n, r), At = transposed(A, 3, r);
        const N = times(At, A, r, 3, r), size = Math.max(...N, 1e-12);
        for (let i = 0; i < r; i++) N[i * (r + 1)] += 1e-3 * size;
        const step = solve(N, times(At, away, r, 3, 1), r, 1).X, length = Math.hypot(...step);
        if (length < 1e-6) break;
        const part = Math.min(1, .3 / length);
        if (this.moveTo(z, this.v.map((x, i) => x + part * step[i])) < 1) break;
      }
    }
  }

  // -- the manifold of one redundant joint -----------------------------------------------------------------------------
  /** Joints along the curve at a task point that a posture is on: nodes, arc lengths, and whether it is closed.
   * A generator, so that the work is spread over pictures: it pauses at each node.
   */
  function* trace(robot, q, z, { step = .06, most = 3000 } = {}) {
    const { m, n } = robot;
    /** Part of a motion that leaves the task at rest. */
    const along = (J, motion) => {
      const Q = rowBasis(J, m, n), less = times(Q, times(transposed(Q, n, m), motion, m, n, 1), n, m, 1);
      const t = motion.map((x, i) => x - less[i]), length = Math.hypot(...t);
      return { t: t.map(x => x / length), length };
    };
    const start = Float64Array.from(q), { J: J0 } = robot.evaluate(start);
    let first = null;
    for (let i = 0; i < n && !first; i++) {
      const unit = new Float64Array(n);
      unit[i] = 1;
      const { t, length } = along(J0, unit);
      if (length > .35 || i === n - 1) first = t;
    }
    function* walk(sense) {
      const nodes = [start], s = [0];
      let t = first.map(x => sense * x), here = start, length = step;
      while (nodes.length < most) {
        let x = here.map((value, i) => value + length * t[i]), ahead = null;
        for (let k = 0; k < 8; k++) {
          const { z: at, J } = robot.evaluate(x), error = robot.error(at, z);
          if (Math.max(...error.map(Math.abs)) < 1e-11) { ahead = along(J, t); break; }
          const found = solve(times(J, transposed(J, m, n), m, n, m), error, m, 1);
          if (!found) break;
          const move = times(transposed(J, m, n), found.X, n, m, 1);
          x = x.map((value, i) => value - move[i]);
        }
        const moved = Math.hypot(...x.map((value, i) => value - here[i]));
        // The length of what is left of the last direction is the cosine of the bend.
        if (!ahead || ahead.length < .97 || moved > 1.5 * length) {
          length *= .5;
          if (length < 1e-5) return { nodes, s, closed: false };
          continue;
        }
        nodes.push(x);
        s.push(s[s.length - 1] + moved);
        yield x;
        [here, t, length] = [x, ahead.t, Math.min(step, 1.5 * length)];
        const home = x.map((value, i) => { const d = value - start[i]; return robot.prismatic[i] ? d : d - 2 * Math.PI * Math.round(d / (2 * Math.PI)); });
        const gap = Math.hypot(...home), onward = home.reduce((sum, value, i) => sum - value * t[i], 0);
        if (nodes.length > 8 && gap < 1.2 * step && onward > 0 && onward > .8 * gap) {
          nodes.push(x.map((value, i) => value - home[i]));
          s.push(s[s.length - 1] + gap);
          return { nodes, s, closed: true };
        }
      }
      return { nodes, s, closed: false };
    }
    const forth = yield* walk(1);
    if (forth.closed) {
      // Half a round to either side: joints that wind are where they get to from here, by the shorter way.
      const { nodes, s } = forth, whole = s[s.length - 1], half = s.findIndex(x => x >= .5 * whole), home = nodes[nodes.length - 1].map((x, i) => x - start[i]);
      return {
        nodes: [...nodes.slice(half).map(q => q.map((x, i) => x - home[i])), ...nodes.slice(1, half + 1)],
        s: [...s.slice(half).map(x => x - s[half]), ...s.slice(1, half + 1).map(x => x + whole - s[half])], closed: true };
    }
    const back = yield* walk(-1), length = back.s[back.s.length - 1];
    return {
      nodes: [...back.nodes.slice(1).reverse(), ...forth.nodes],
      s: [...back.s.slice(1).reverse().map(x => length - x), ...forth.s.map(x => length + x)], closed: false };
  }

  return { Robot, Chart, Posture, trace, THRESHOLD };
})();
if (typeof module !== "undefined") module.exports = Kinematics;
