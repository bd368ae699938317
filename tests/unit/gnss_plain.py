"""Plain numpy filters, written anew, that the navigator's are held against."""

from __future__ import annotations

import celestcore as cc
import numpy as np
from celestcore.orbit import propagate
from scipy.linalg import block_diag
from scipy.spatial.transform import Rotation


def orbit_filter(force, q, t, z_r, z_v, sigmas, start, *, back=False, environment=None, epoch=None):
    """Extended Kalman filter on positions and velocities in the GCRS, and its RTS smoother."""
    x, p = start
    sigma_r, sigma_v = sigmas
    states, covs, priors, transitions = [], [], [], []
    for k, at in enumerate(t):
        if k:
            dt = at - t[k - 1]
            step = propagate(
                force,
                epoch,
                x[:3],
                x[3:],
                [t[k - 1], at],
                method="rk4",
                step=30.0,
                stm=True,
                environment=environment,
            )
            f = step.stm[-1]
            x = np.append(step.r[-1], step.v[-1])
            one = q * np.array([[dt**3 / 3, dt**2 / 2], [dt**2 / 2, dt]])
            p = f @ p @ f.T + np.kron(one, np.eye(3))
            transitions.append(f)
            priors.append((x, p))
        h = np.eye(6)
        z = np.append(z_r[k], z_v[k])
        r = np.diag(np.repeat([sigma_r**2, sigma_v**2], 3))
        gain = p @ h.T @ np.linalg.inv(h @ p @ h.T + r)
        x = x + gain @ (z - x)
        p = (np.eye(6) - gain) @ p @ (np.eye(6) - gain).T + gain @ r @ gain.T
        states.append(x)
        covs.append(p)
    if back:
        for k in reversed(range(len(t) - 1)):
            xp, pp = priors[k]
            g = covs[k] @ transitions[k].T @ np.linalg.inv(pp)
            states[k] = states[k] + g @ (states[k + 1] - xp)
            covs[k] = covs[k] + g @ (covs[k + 1] - pp) @ g.T
    return np.array(states), np.array(covs)


def white_jerk(q, dt):
    one = np.array(
        [
            [dt**5 / 20, dt**4 / 8, dt**3 / 6],
            [dt**4 / 8, dt**3 / 3, dt**2 / 2],
            [dt**3 / 6, dt**2 / 2, dt],
        ]
    )
    return q * np.kron(one, np.eye(3))


def pointing_filter(q_psd, t, fixes, sigma, weights, prior, start):
    """Attitude, rate, acceleration and a slow error as a linear filter about the first fix."""
    first = Rotation.from_quat(fixes[0], scalar_first=True)
    turn = (first.inv() * Rotation.from_quat(fixes, scalar_first=True)).as_rotvec()
    vectors = weights.shape[1]
    x = np.zeros(9 + 3 * vectors)
    p = block_diag(*[s * s * np.eye(3) for s in start], *[s * s * np.eye(3) for s in prior])
    out = []
    for k, at in enumerate(t):
        if k:
            dt = at - t[k - 1]
            f = np.eye(len(x))
            f[:9, :9] = np.kron([[1, dt, dt**2 / 2], [0, 1, dt], [0, 0, 1]], np.eye(3))
            x = f @ x
            p = f @ p @ f.T
            p[:9, :9] += white_jerk(q_psd, dt)
        h = np.hstack([np.eye(3), np.zeros((3, 6)), np.kron(weights[k], np.eye(3))])
        s = h @ p @ h.T + sigma**2 * np.eye(3)
        gain = p @ h.T @ np.linalg.inv(s)
        x = x + gain @ (turn[k] - h @ x)
        p = p - gain @ s @ gain.T
        out.append((x, p))
    q = first * Rotation.from_rotvec(np.array([o[0][:3] for o in out]))
    return q, np.array([o[0] for o in out]), np.array([o[1] for o in out])


def angle(a, b):
    """Angles between attitudes [rad]."""
    turn = cc.quaternion.multiply(cc.quaternion.conjugate(a), b)
    return np.linalg.norm(cc.quaternion.log(turn), axis=1)
