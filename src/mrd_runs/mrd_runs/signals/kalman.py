"""Kernels of the motion smoother: Kalman filter, fixed-interval smoother, and random draws of the smoothing errors.

Time is in time constants of the smoother, which makes all elements of the state about equally large. Variances are in units
of the variance of the position noise. In these units the spectral density of the white derivative is the sampling interval.
The state has 3 to 5 elements; its small matrices are changed in place.

The kernels share these arguments: ``intervals`` (n,) between the samples (the last one is not used), measured ``position``
(n,) and ``acceleration`` (n,), the state ``start`` (order,) at the first sample, the spectral ``density``, and the ``gain``
(0: none) and ``variance`` of the accelerometer.
"""

import math

import numpy as np
from numba import njit

from mrd_base.kernel_cache import write_one_at_a_time

write_one_at_a_time()


@njit(cache=True, nogil=True)
def _initial_covariance(order, density):  # type: ignore[no-untyped-def]
    """Return a covariance far wider than the error of the first state, yet narrow enough to keep digits in what follows."""
    P = np.zeros((order, order))
    for i in range(order):
        P[i, i] = 1e4 * max(1.0, density) ** (2 * (order - i))
    return P


@njit(cache=True, nogil=True)
def _unit_process_covariance(order):  # type: ignore[no-untyped-def]
    """Return the covariance that the white derivative adds to the state in unit time at unit density."""
    Q = np.empty((order, order))
    for i in range(order):
        for j in range(order):
            a, b = order - 1 - i, order - 1 - j
            Q[i, j] = 1 / ((a + b + 1) * math.gamma(a + 1.0) * math.gamma(b + 1.0))
    return Q


@njit(cache=True, nogil=True)
def _set_transition(h, density, unit_Q, F, Q):  # type: ignore[no-untyped-def]
    """Fill the transition matrix ``F`` over a time ``h`` and the covariance ``Q`` that is added in it."""
    order = F.shape[0]
    for i in range(order):
        F[i, i] = 1.0
        for j in range(i + 1, order):
            F[i, j] = F[i, j - 1] * h / (j - i)
    for i in range(order):
        power = density * h
        for _ in range(order - 1 - i):
            power *= h
        for j in range(order - 1, -1, -1):
            Q[i, j] = unit_Q[i, j] * power
            power *= h


@njit(cache=True, nogil=True)
def _update_covariance(P, element, gain, variance, K):  # type: ignore[no-untyped-def]
    """Reduce ``P`` by a reading of gain·state[element], fill the gains ``K``, return the variance of the innovation."""
    order = len(K)
    predicted = gain * gain * P[element, element] + variance
    for i in range(order):
        K[i] = gain * P[i, element] / predicted
    for i in range(order):
        if i != element:
            for j in range(order):
                if j != element:
                    P[i, j] -= K[i] * K[j] * predicted
    # This form of the row of the element avoids the difference of two large numbers.
    for i in range(order):
        rest = K[i] * variance / gain
        P[i, element] = rest
        P[element, i] = rest
    return predicted


@njit(cache=True, nogil=True)
def _predict_covariance(P, F, Q, work):  # type: ignore[no-untyped-def]
    """P ← F P Fᵀ + Q, in place; F is upper triangular."""
    order = P.shape[0]
    for i in range(order):
        for j in range(order):
            value = P[i, j]
            for k in range(i + 1, order):
                value += F[i, k] * P[k, j]
            work[i, j] = value
    for i in range(order):
        for j in range(i, order):
            value = work[i, j]
            for k in range(j + 1, order):
                value += work[i, k] * F[j, k]
            P[i, j] = value + Q[i, j]
            P[j, i] = P[i, j]


@njit(cache=True, nogil=True)
def _predict_state(state, F):  # type: ignore[no-untyped-def]
    """State ← F state, in place."""
    order = len(state)
    for i in range(order - 1):
        value = state[i]
        for j in range(i + 1, order):
            value += F[i, j] * state[j]
        state[i] = value


@njit(cache=True, nogil=True)
def _converged(P, diagonal):  # type: ignore[no-untyped-def]
    """Whether the diagonal of ``P`` has stayed as it was; ``diagonal`` holds the old values and gets the new ones."""
    same = True
    for i in range(len(diagonal)):
        same &= abs(P[i, i] - diagonal[i]) <= 1e-12 * P[i, i]
        diagonal[i] = P[i, i]
    return same


@njit(cache=True, nogil=True)
def innovation_sums(intervals, position, acceleration, start, density, gain, variance):  # type: ignore[no-untyped-def]
    """Return sums over the innovations e (errors of the one-step predictions) with variance V.

    Rows: position, accelerometer. Columns: count, Σe²/V, Σe·o/V, Σo²/V, Σ log V, where o is the response of the innovations
    to an accelerometer offset of 1.
    """
    n, order = len(position), len(start)
    sums = np.zeros((2, 5))
    state, response = start.copy(), np.zeros(order)
    P, work, diagonal = _initial_covariance(order, density), np.empty((order, order)), np.zeros(order)
    K, C = np.zeros(order), np.zeros(order)
    F, Q, unit_Q = np.zeros((order, order)), np.zeros((order, order)), _unit_process_covariance(order)
    f = g = 1.0  # inverse variances of the predictions
    log_f = log_g = 0.0
    steady, last = False, 0.0
    for k in range(n):
        if not steady:
            f = 1 / _update_covariance(P, 0, 1.0, 1.0, K)
            log_f = -math.log(f)
            if gain != 0.0:
                g = 1 / _update_covariance(P, 2, gain, variance, C)
                log_g = -math.log(g)
        counts = k >= order  # the first readings only determine the state
        e = position[k] - state[0]
        for i in range(order):
            state[i] += K[i] * e
        if counts:
            sums[0, 0] += 1
            sums[0, 1] += e * e * f
            sums[0, 4] += log_f
        if gain != 0.0:
            o = -response[0]
            if counts:
                sums[0, 2] += e * o * f
                sums[0, 3] += o * o * f
            for i in range(order):
                response[i] += K[i] * o
            e, o = acceleration[k] - gain * state[2], 1.0 - gain * response[2]
            for i in range(order):
                state[i] += C[i] * e
                response[i] += C[i] * o
            if counts:
                sums[1, 0] += 1
                sums[1, 1] += e * e * g
                sums[1, 2] += e * o * g
                sums[1, 3] += o * o * g
                sums[1, 4] += log_g
        # With equal intervals the gains settle; from then on, only the state is computed.
        even = abs(intervals[k] - last) <= 1e-6 * last
        if not even:
            last = intervals[k]
            _set_transition(last, density, unit_Q, F, Q)
        if not (steady and even):
            _predict_covariance(P, F, Q, work)
            steady = _converged(P, diagonal) and even
        _predict_state(state, F)
        if gain != 0.0:
            _predict_state(response, F)
    return sums


@njit(cache=True, nogil=True)
def _filter(intervals, position, acceleration, start, density, gain, variance):  # type: ignore[no-untyped-def]
    """Return the predicted states (n, order), the innovations (n, 2) and the covariances of the predictions.

    Each covariance is stored once: that of sample k is covariances[which[k]].
    """
    n, order = len(position), len(start)
    states, innovations = np.empty((n, order)), np.zeros((n, 2))
    which, covariances, stored = np.empty(n, np.int64), np.empty((n, order, order)), -1
    state = start.copy()
    P, work, diagonal = _initial_covariance(order, density), np.empty((order, order)), np.zeros(order)
    K, C = np.zeros(order), np.zeros(order)
    F, Q, unit_Q = np.zeros((order, order)), np.zeros((order, order)), _unit_process_covariance(order)
    steady, last = False, 0.0
    for k in range(n):
        if not steady:
            stored += 1
            _copy(P, covariances[stored])
            _update_covariance(P, 0, 1.0, 1.0, K)
            if gain != 0.0:
                _update_covariance(P, 2, gain, variance, C)
        which[k] = stored
        for i in range(order):
            states[k, i] = state[i]
        innovations[k, 0] = position[k] - state[0]
        for i in range(order):
            state[i] += K[i] * innovations[k, 0]
        if gain != 0.0:
            innovations[k, 1] = acceleration[k] - gain * state[2]
            for i in range(order):
                state[i] += C[i] * innovations[k, 1]
        even = abs(intervals[k] - last) <= 1e-6 * last
        if not even:
            last = intervals[k]
            _set_transition(last, density, unit_Q, F, Q)
        if not (steady and even):
            _predict_covariance(P, F, Q, work)
            steady = _converged(P, diagonal) and even
        _predict_state(state, F)
    return states, innovations, which, covariances


@njit(cache=True, nogil=True)
def smooth_states(intervals, position, acceleration, start, density, gain, variance):  # type: ignore[no-untyped-def]
    """Return the smoothed x, ẋ, ẍ (n, 3)."""
    states, innovations, which, covariances = _filter(intervals, position, acceleration, start, density, gain, variance)
    n, order = states.shape
    smooth, score = np.empty((n, 3)), np.zeros(order)
    P, K, C = np.empty((order, order)), np.zeros(order), np.zeros(order)
    F, Q, unit_Q = np.zeros((order, order)), np.zeros((order, order)), _unit_process_covariance(order)
    f = g = 1.0  # inverse variances of the predictions
    last = 0.0
    for k in range(n - 1, -1, -1):
        if k < n - 1:
            if abs(intervals[k] - last) > 1e-6 * last:
                last = intervals[k]
                _set_transition(last, density, unit_Q, F, Q)
            for i in range(order - 1, 0, -1):  # score ← Fᵀ score
                for j in range(i):
                    score[i] += F[j, i] * score[j]
        predicted = covariances[which[k]]
        if k == n - 1 or which[k] != which[k + 1]:
            _copy(predicted, P)
            f = 1 / _update_covariance(P, 0, 1.0, 1.0, K)
            if gain != 0.0:
                g = 1 / _update_covariance(P, 2, gain, variance, C)
        if gain != 0.0:
            _update_score(score, 2, gain, innovations[k, 1] * g, C)
        _update_score(score, 0, 1.0, innovations[k, 0] * f, K)
        for i in range(3):
            value = states[k, i]
            for j in range(order):
                value += predicted[i, j] * score[j]
            smooth[k, i] = value
    return smooth


@njit(cache=True, nogil=True)
def _update_score(score, element, gain, weighted_innovation, K):  # type: ignore[no-untyped-def]
    """Score ← Lᵀ score + H e/V for a reading, with L = I - K H."""
    inner = 0.0
    for i in range(len(score)):
        inner += K[i] * score[i]
    score[element] += gain * (weighted_innovation - inner)


@njit(cache=True, nogil=True)
def draw_errors(intervals, parts, normal, density, gain, variance):  # type: ignore[no-untyped-def]
    """Draw errors (3, count, n) of the smoothed x, ẋ, ẍ from standard normal numbers (n, count, order).

    Only the first of every ``parts`` instants has a reading. Given the error of the next state, the error of a state is
    J·(that error) + (I - J F) a - J w with J = P Fᵀ (F P Fᵀ + Q)⁻¹. Here a is the error of the filtered estimate, with
    covariance P, and w is what the white derivative adds, with covariance Q.
    """
    n, count, order = normal.shape
    which, covariances, stored = np.empty(n, np.int64), np.empty((n, order, order)), -1
    P, work, diagonal = _initial_covariance(order, density), np.empty((order, order)), np.zeros(order)
    K = np.zeros(order)
    F, Q, unit_Q = np.zeros((order, order)), np.zeros((order, order)), _unit_process_covariance(order)
    steady, last = False, 0.0
    for k in range(n):
        if not steady:
            stored += 1
            if k % parts == 0:
                _update_covariance(P, 0, 1.0, 1.0, K)
                if gain != 0.0:
                    _update_covariance(P, 2, gain, variance, K)
            _copy(P, covariances[stored])
        which[k] = stored
        even = abs(intervals[k] - last) <= 1e-6 * last
        if not even:
            last = intervals[k]
            _set_transition(last, density, unit_Q, F, Q)
        if not (steady and even):
            _predict_covariance(P, F, Q, work)
            steady = _converged(P, diagonal) and even and parts == 1

    drawn = np.empty((3, count, n))
    J, root = np.zeros((order, order)), np.zeros((order, order))
    _set_root(covariances[which[n - 1]], root)
    errors, following = np.zeros(order), np.zeros((count, order))
    last = 0.0
    for k in range(n - 1, -1, -1):
        if k < n - 1 and (which[k] != which[k + 1] or k == n - 2 or abs(intervals[k] - last) > 1e-6 * last):
            last = intervals[k]
            _set_transition(last, density, unit_Q, F, Q)
            filtered = covariances[which[k]]
            _copy(filtered, P)
            _predict_covariance(P, F, Q, work)
            _set_root(P, root)
            _set_gain(filtered, F, root, J)
            _set_covariance_of_draw(filtered, F, Q, J, work, P)
            _set_root(P, root)
        for draw in range(count):
            for i in range(order):
                errors[i] = 0.0
                for j in range(order):
                    errors[i] += J[i, j] * following[draw, j] + root[i, j] * normal[k, draw, j]
            for i in range(order):
                following[draw, i] = errors[i]
            for i in range(3):
                drawn[i, draw, k] = errors[i]
    return drawn


@njit(cache=True, nogil=True)
def _copy(matrix, to):  # type: ignore[no-untyped-def]
    """Copy a square matrix. The compiler takes ten times as long for ``to[:, :] = matrix``."""
    for i in range(len(matrix)):
        for j in range(len(matrix)):
            to[i, j] = matrix[i, j]


@njit(cache=True, nogil=True)
def _set_gain(filtered, F, root, J):  # type: ignore[no-untyped-def]
    """J ← P Fᵀ (L Lᵀ)⁻¹ with the ``filtered`` covariance P and the Cholesky factor L (``root``) of the predicted one."""
    order = len(F)
    for i in range(order):
        for j in range(order):
            J[i, j] = 0.0
            for k in range(j, order):
                J[i, j] += F[j, k] * filtered[k, i]
            for k in range(j):
                J[i, j] -= root[j, k] * J[i, k]
            J[i, j] /= root[j, j]
        for j in range(order - 1, -1, -1):
            for k in range(j + 1, order):
                J[i, j] -= root[k, j] * J[i, k]
            J[i, j] /= root[j, j]


@njit(cache=True, nogil=True)
def _set_covariance_of_draw(filtered, F, Q, J, rest, result):  # type: ignore[no-untyped-def]
    """Fill ``result`` with (I - J F) P (I - J F)ᵀ + J Q Jᵀ and ``rest`` with I - J F; P is the ``filtered`` covariance."""
    order = len(F)
    for i in range(order):
        for j in range(order):
            rest[i, j] = 1.0 if i == j else 0.0
            for k in range(j + 1):
                rest[i, j] -= J[i, k] * F[k, j]
    for i in range(order):
        for j in range(order):
            result[i, j] = 0.0
            for k in range(order):
                for m in range(order):
                    result[i, j] += rest[i, k] * filtered[k, m] * rest[j, m] + J[i, k] * Q[k, m] * J[j, m]


@njit(cache=True, nogil=True)
def _set_root(covariance, root):  # type: ignore[no-untyped-def]
    """Fill ``root`` with the Cholesky factor of a covariance that rounding may have made slightly indefinite."""
    order = len(covariance)
    for i in range(order):
        for j in range(i + 1):
            rest = covariance[i, j]
            for k in range(j):
                rest -= root[i, k] * root[j, k]
            if i == j:
                root[i, i] = math.sqrt(max(rest, 0.0))
            elif root[j, j] > 0.0:
                root[i, j] = rest / root[j, j]
            else:
                root[i, j] = 0.0
