"""Kernels of the smoother of motions: Kalman filter, fixed-interval smoother, draws of what they leave open.

Time counts in time constants of the smoother, which makes all elements of the state about equally large, and variances in
units of the position's noise variance. In these units the spectral density of the white derivative is the sampling interval.
The state has 3 to 5 elements; its small matrices are worked on in place.
"""

import math

import numpy as np
from numba import njit


@njit(cache=True, nogil=True)
def _prior(order, density):  # type: ignore[no-untyped-def]
    """Covariance of the first state: far wider than its error, narrow enough to keep the digits of what follows."""
    P = np.zeros((order, order))
    for i in range(order):
        P[i, i] = 1e4 * max(1.0, density) ** (2 * (order - i))
    return P


@njit(cache=True, nogil=True)
def _shares(order):  # type: ignore[no-untyped-def]
    """Covariance that the white derivative adds to the state in unit time at unit density."""
    Q = np.empty((order, order))
    for i in range(order):
        for j in range(order):
            a, b = order - 1 - i, order - 1 - j
            Q[i, j] = 1 / ((a + b + 1) * math.gamma(a + 1.0) * math.gamma(b + 1.0))
    return Q


@njit(cache=True, nogil=True)
def _set_interval(h, density, shares, F, Q):  # type: ignore[no-untyped-def]
    """Fill the transition ``F`` over ``h`` and the covariance ``Q`` added meanwhile."""
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
            Q[i, j] = shares[i, j] * power
            power *= h


@njit(cache=True, nogil=True)
def _read(P, element, gain, noise, K):  # type: ignore[no-untyped-def]
    """Reduce ``P`` by one reading of gain·state[element]; fill the gains ``K``, return the variance of its prediction."""
    order = len(K)
    variance = gain * gain * P[element, element] + noise
    for i in range(order):
        K[i] = gain * P[i, element] / variance
    for i in range(order):
        if i != element:
            for j in range(order):
                if j != element:
                    P[i, j] -= K[i] * K[j] * variance
    # What the reading leaves of its own element, without the difference of two large numbers.
    for i in range(order):
        rest = K[i] * noise / gain
        P[i, element] = rest
        P[element, i] = rest
    return variance


@njit(cache=True, nogil=True)
def _advance(P, F, Q, work):  # type: ignore[no-untyped-def]
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
def _move(state, F):  # type: ignore[no-untyped-def]
    order = len(state)
    for i in range(order - 1):
        value = state[i]
        for j in range(i + 1, order):
            value += F[i, j] * state[j]
        state[i] = value


@njit(cache=True, nogil=True)
def _settled(P, before):  # type: ignore[no-untyped-def]
    """Whether the diagonal is still that of ``before``; ``before`` takes its values."""
    same = True
    for i in range(len(before)):
        same &= abs(P[i, i] - before[i]) <= 1e-12 * P[i, i]
        before[i] = P[i, i]
    return same


@njit(cache=True, nogil=True)
def innovations(steps, reading, second, start, density, gain, second_noise):  # type: ignore[no-untyped-def]
    """Sums over the one-step prediction errors e with variance V, rows position and accelerometer.

    Columns: count, Σe²/V, Σe·o/V, Σo²/V, Σ log V, where o is the response of the errors to an accelerometer offset of 1.
    With ``gain`` 0 there is no accelerometer.
    """
    n, order = len(reading), len(start)
    sums = np.zeros((2, 5))
    state, response = start.copy(), np.zeros(order)
    P, work, before = _prior(order, density), np.empty((order, order)), np.zeros(order)
    K, C = np.zeros(order), np.zeros(order)
    F, Q, shares = np.zeros((order, order)), np.zeros((order, order)), _shares(order)
    f = g = 1.0  # inverse variances of the predictions
    log_f = log_g = 0.0
    steady, last = False, 0.0
    for k in range(n):
        if not steady:
            f = 1 / _read(P, 0, 1.0, 1.0, K)
            log_f = -math.log(f)
            if gain != 0.0:
                g = 1 / _read(P, 2, gain, second_noise, C)
                log_g = -math.log(g)
        counts = k >= order  # the first readings only find the state
        e = reading[k] - state[0]
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
            e, o = second[k] - gain * state[2], 1.0 - gain * response[2]
            for i in range(order):
                state[i] += C[i] * e
                response[i] += C[i] * o
            if counts:
                sums[1, 0] += 1
                sums[1, 1] += e * e * g
                sums[1, 2] += e * o * g
                sums[1, 3] += o * o * g
                sums[1, 4] += log_g
        # On a uniform clock the gains settle; from there only the state is computed.
        even = abs(steps[k] - last) <= 1e-6 * last
        if not even:
            last = steps[k]
            _set_interval(last, density, shares, F, Q)
        if not (steady and even):
            _advance(P, F, Q, work)
            steady = _settled(P, before) and even
        _move(state, F)
        if gain != 0.0:
            _move(response, F)
    return sums


@njit(cache=True, nogil=True)
def smoother(steps, reading, second, start, density, gain, second_noise):  # type: ignore[no-untyped-def]
    """Smoothed x, ẋ, ẍ, shape (n, 3), and variance of ẋ, shape (n,), in the units of the kernels."""
    n, order = len(reading), len(start)
    states, errors = np.empty((n, order)), np.zeros((n, 2))
    # Covariances of the predictions, each stored once: that of sample k is kept[which[k]].
    which, kept, held = np.empty(n, np.int64), np.empty((n, order, order)), -1
    state = start.copy()
    P, work, before = _prior(order, density), np.empty((order, order)), np.zeros(order)
    K, C = np.zeros(order), np.zeros(order)
    F, Q, shares = np.zeros((order, order)), np.zeros((order, order)), _shares(order)
    steady, last = False, 0.0
    for k in range(n):
        if not steady:
            held += 1
            kept[held] = P
            _read(P, 0, 1.0, 1.0, K)
            if gain != 0.0:
                _read(P, 2, gain, second_noise, C)
        which[k] = held
        states[k] = state
        errors[k, 0] = reading[k] - state[0]
        for i in range(order):
            state[i] += K[i] * errors[k, 0]
        if gain != 0.0:
            errors[k, 1] = second[k] - gain * state[2]
            for i in range(order):
                state[i] += C[i] * errors[k, 1]
        even = abs(steps[k] - last) <= 1e-6 * last
        if not even:
            last = steps[k]
            _set_interval(last, density, shares, F, Q)
        if not (steady and even):
            _advance(P, F, Q, work)
            steady = _settled(P, before) and even
        _move(state, F)

    smooth, variance = np.empty((n, 3)), np.empty(n)
    r, N = np.zeros(order), np.zeros((order, order))
    before[:] = 0.0
    f = g = 1.0
    spread = 0.0
    steady, last = False, 0.0
    for k in range(n - 1, -1, -1):
        if k < n - 1:
            if abs(steps[k] - last) > 1e-6 * last:
                last = steps[k]
                _set_interval(last, density, shares, F, Q)
                steady = False
            for i in range(order - 1, 0, -1):  # r ← Fᵀ r
                for j in range(i):
                    r[i] += F[j, i] * r[j]
        predicted = kept[which[k]]
        same = k < n - 1 and which[k] == which[k + 1]
        steady = steady and same
        if not same:
            P[:, :] = predicted
            f = 1 / _read(P, 0, 1.0, 1.0, K)
            if gain != 0.0:
                g = 1 / _read(P, 2, gain, second_noise, C)
        if gain != 0.0:
            _unread(r, 2, gain, errors[k, 1] * g, C)
        _unread(r, 0, 1.0, errors[k, 0] * f, K)
        if not steady:
            if k < n - 1:
                _retreat(N, F, work)
            if gain != 0.0:
                _unread_variance(N, 2, gain, g, C, work)
            _unread_variance(N, 0, 1.0, f, K, work)
            spread = predicted[1, 1]
            for i in range(order):
                for j in range(order):
                    spread -= predicted[1, i] * N[i, j] * predicted[j, 1]
            steady = _settled(N, before) and same
        for i in range(3):
            value = states[k, i]
            for j in range(order):
                value += predicted[i, j] * r[j]
            smooth[k, i] = value
        variance[k] = spread
    return smooth, variance


@njit(cache=True, nogil=True)
def _unread(r, element, gain, weighted_error, K):  # type: ignore[no-untyped-def]
    """r ← Lᵀ r + H e/V of one reading, L = I - K H."""
    inner = 0.0
    for i in range(len(r)):
        inner += K[i] * r[i]
    r[element] += gain * (weighted_error - inner)


@njit(cache=True, nogil=True)
def _retreat(N, F, work):  # type: ignore[no-untyped-def]
    """N ← Fᵀ N F, in place."""
    order = N.shape[0]
    for i in range(order):
        for j in range(order):
            value = N[i, j]
            for k in range(i):
                value += F[k, i] * N[k, j]
            work[i, j] = value
    for i in range(order):
        for j in range(order):
            value = work[i, j]
            for k in range(j):
                value += work[i, k] * F[k, j]
            N[i, j] = value


@njit(cache=True, nogil=True)
def _unread_variance(N, element, gain, weight, K, work):  # type: ignore[no-untyped-def]
    """N ← Lᵀ N L + Hᵀ H/V of one reading, ``weight`` = 1/V."""
    order = len(K)
    total = 0.0
    for i in range(order):
        value = 0.0
        for j in range(order):
            value += N[i, j] * K[j]
        work[0, i] = value
        total += K[i] * value
    for i in range(order):
        N[i, element] -= gain * work[0, i]
        N[element, i] -= gain * work[0, i]
    N[element, element] += gain * gain * (total + weight)


@njit(cache=True, nogil=True)
def draw_errors(steps, parts, normal, density, gain, second_noise):  # type: ignore[no-untyped-def]
    """Errors of the smoothed x, ẋ, ẍ from standard normal numbers (n, count, order): (3, count, n), in the kernels' units.

    Of ``parts`` instants, the first one is read.
    Given the next state, the error of a state is J·(that of the next) + (I - J F) a - J w with J = P Fᵀ (F P Fᵀ + Q)⁻¹. The
    error of its filtered estimate, a, has covariance P; what the white derivative adds, w, has covariance Q.
    """
    n, count, order = normal.shape
    which, kept, held = np.empty(n, np.int64), np.empty((n, order, order)), -1
    P, work, before = _prior(order, density), np.empty((order, order)), np.zeros(order)
    K = np.zeros(order)
    F, Q, shares = np.zeros((order, order)), np.zeros((order, order)), _shares(order)
    steady, last = False, 0.0
    for k in range(n):
        if not steady:
            held += 1
            if k % parts == 0:
                _read(P, 0, 1.0, 1.0, K)
                if gain != 0.0:
                    _read(P, 2, gain, second_noise, K)
            kept[held] = P
        which[k] = held
        even = abs(steps[k] - last) <= 1e-6 * last
        if not even:
            last = steps[k]
            _set_interval(last, density, shares, F, Q)
        if not (steady and even):
            _advance(P, F, Q, work)
            steady = _settled(P, before) and even and parts == 1

    drawn = np.empty((3, count, n))
    J, root = np.zeros((order, order)), _root(kept[which[n - 1]])
    errors = np.zeros((count, order))
    last = 0.0
    for k in range(n - 1, -1, -1):
        if k < n - 1 and (which[k] != which[k + 1] or k == n - 2 or abs(steps[k] - last) > 1e-6 * last):
            last = steps[k]
            _set_interval(last, density, shares, F, Q)
            P[:, :] = kept[which[k]]
            _advance(P, F, Q, work)
            scale = np.sqrt(np.diag(P))
            J[:, :] = (np.linalg.solve(P / np.outer(scale, scale), (F @ kept[which[k]]) / scale.reshape(-1, 1))).T / scale
            rest = np.eye(order) - J @ F
            root = _root(rest @ kept[which[k]] @ rest.T + J @ Q @ J.T)
        errors = errors @ J.T + normal[k] @ root.T
        drawn[0, :, k], drawn[1, :, k], drawn[2, :, k] = errors[:, 0], errors[:, 1], errors[:, 2]
    return drawn


@njit(cache=True, nogil=True)
def _root(covariance):  # type: ignore[no-untyped-def]
    """Lower triangular root of a covariance that rounding may have left slightly indefinite."""
    order = len(covariance)
    root = np.zeros((order, order))
    for i in range(order):
        for j in range(i + 1):
            rest = covariance[i, j]
            for k in range(j):
                rest -= root[i, k] * root[j, k]
            if i == j:
                root[i, i] = math.sqrt(max(rest, 0.0))
            elif root[j, j] > 0.0:
                root[i, j] = rest / root[j, j]
    return root
