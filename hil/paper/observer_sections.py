"""Parts of the report: fig. 8, tolerance, noise. Each measures, judges and, given a folder, draws."""

from concurrent.futures import Executor
from dataclasses import asdict

import numpy as np

from hil.paper import frequency_response, noise, robustness
from hil.paper.cells import URAD, listed, urad
from hil.paper.report import Claim, Folder, Section, Table

FIG8_TEXT = (
    "Sinusoidal torque on every joint of the linearised rig (no gravity, no Coulomb friction), G and 1 - G from the "
    "plant's truth, at g = 700 rad/s. The figure's own g = 1000 rad/s is drawn by formula only: with 1 ms, g T would "
    "be 1, and this bus's delay makes the loop unstable just below (see the limits). The delay also raises 1 - G "
    "above one around g, which the continuous formula does not show: the price of sampling. Theory: u_k = a_k + g T "
    "(a_0 + .. + a_k-1) - g w_k, each current acting as late as its frame ended."
)
TOLERANCE_TEXT = (
    "Every Jn of the controllers times a factor, and a payload on the hand from the start. The limits are those at "
    "which paper-joint fails (fault, saturation, or a deviation of 10 mrad), beside the eigenvalues of the sampled "
    "loop at the least stable pose of the motion, with the mean delays of the frames."
)
NOISE_TEXT = (
    "One count of the encoder is worth g Jn / (Ktn T) counts of current; rounding makes noise of a variance of LSB^2 "
    "/ 12, which the loop shapes. The map marks where the amplifier's limit is reached: there the noise has become a "
    "limit cycle."
)


def fig8(executor: Executor, folder: Folder) -> Section:
    """Fig. 8: G and 1 - G."""
    found = frequency_response.measure(executor)
    g = found.loops[0].g
    below = found.rad_s <= g * 1.001
    worst_dB = float(np.max(np.abs(found.error_dB[below])))
    slope = frequency_response.dB(found.measured) - 20 * np.log10(found.rad_s / g)[:, None]
    slope_dB = float(np.max(np.abs(slope[found.rad_s <= g / 10])))
    if folder is not None:
        from hil.paper.plots import draw_fig8

        draw_fig8(folder / "fig8", found)
    measured = frequency_response.dB(found.measured)
    rows = [
        (
            f"{w:.0f}",
            *(f"{value:.2f} ({error:+.2f})" for value, error in zip(measured[k], found.error_dB[k], strict=True)),
        )
        for k, w in enumerate(found.rad_s)
    ]
    header = ("rad/s", *(f"joint {n + 1}: |1 - G|, dB (off theory)" for n in range(len(found.loops))))
    return Section(
        "fig8",
        "Fig. 8: what the observer lets through",
        FIG8_TEXT,
        [
            Claim("|1 - G| falls with s/g below g", "fig. 8", f"within {slope_dB:.2f} dB up to g/10", slope_dB <= 1.0),
            Claim(
                "G and 1 - G as designed (here: of the sampled loop, KA and KB from g, bus delays in)",
                "eqs. (5)-(7)",
                f"within {worst_dB:.2f} dB up to g",
                worst_dB <= 1.5,
            ),
        ],
        [Table("|1 - G|, measured", header, rows)],
        [("fig8", "G and 1 - G of every joint")],
        {
            "rad_s": found.rad_s.tolist(),
            "measured_dB": measured.tolist(),
            "theory_dB": frequency_response.dB(found.theory).tolist(),
            "delay_s": [loop.delay_s for loop in found.loops],
        },
    )


def tolerance(executor: Executor, folder: Folder) -> Section:
    """Inertia error, payload, and the limits."""
    runs, limits = robustness.tolerated(executor), robustness.limits(executor)
    if folder is not None:
        from hil.paper.plots import draw_tolerance

        draw_tolerance(folder / "tolerance", runs)
    alone = [run for run in runs if run.payload_kg == 0.0 or run.factor == 1.0]
    final, largest = max(max(run.final_rad) for run in runs), max(max(run.largest_rad) for run in alone)
    both = max(max(run.largest_rad) for run in runs)
    rows = [(f"{run.factor:g}", f"{run.payload_kg:g}", urad(run.largest_rad), urad(run.final_rad)) for run in runs]
    return Section(
        "tolerance",
        "Inertia error and payload",
        TOLERANCE_TEXT,
        [
            Claim(
                "an error of inertia or payload is tolerated",
                "eqs. (4), (9)",
                f"final at most {final / URAD:.1f} urad; largest {largest / URAD:.0f} urad for one of the two errors, "
                f"{both / URAD:.0f} urad for both at once",
                final <= 30e-6 and largest <= 600e-6,
            )
        ],
        [
            Table("deviation, urad", ("Jn x", "payload, kg", "largest, joints 1 to 3", "final, joints 1 to 3"), rows),
            Table(
                "up to where the loop holds",
                ("what", "on the rig", "in theory"),
                [(limit.what, f"{limit.measured:.3g}", f"{limit.predicted:.3g}") for limit in limits],
            ),
        ],
        [("tolerance", "deviation over inertia error and payload")],
        {"runs": [asdict(run) for run in runs], "limits": [asdict(limit) for limit in limits]},
    )


def noise_claim(executor: Executor, folder: Folder) -> Section:
    """Encoder resolution and g."""
    runs = noise.heat_map(executor)
    if folder is not None:
        from hil.paper.plots import draw_noise

        draw_noise(folder / "noise", runs, 0)
    at = {(run.counts_per_turn, run.g_rad_s): run for run in runs}
    fine, coarse, coarsest = (at[counts, 700.0] for counts in (819_200, 204_800, 65_536))
    ratios = np.array(coarse.measured_A) / np.array(fine.measured_A)
    ratio = np.array([np.array(run.measured_A) / np.array(run.predicted_A) for run in runs if not run.saturated])
    rows = [
        (
            str(run.counts_per_turn),
            f"{run.g_rad_s:g}",
            listed(run.measured_A, ".3g"),
            listed(run.predicted_A, ".3g"),
            urad(run.largest_rad),
            "x" if run.saturated else "",
        )
        for run in runs
    ]
    header = ("counts a turn", "g, rad/s", "noise, A", "predicted, A", "largest deviation, urad", "limit")
    return Section(
        "noise",
        "Noise of the encoder bounds g from above",
        NOISE_TEXT,
        [
            Claim(
                "sensor noise sets the upper limit of g",
                "text on fig. 8",
                f"current noise at 204 800 counts {listed(ratios, '.2f')} times that at 819 200 (g = 700); measured / "
                f"predicted {np.min(ratio):.2f} to {np.max(ratio):.2f}",
                bool(np.all(np.abs(ratios - 4) < 0.4) and np.min(ratio) > 0.85 and np.max(ratio) < 1.15),
            ),
            Claim(
                "... up to a limit cycle",
                "text on fig. 8",
                "65 536 counts at g = 700: limit reached" if coarsest.saturated else "not reached",
                coarsest.saturated,
            ),
        ],
        [Table("current noise, joints 1 to 3", header, rows)],
        [("noise", "noise in the current of joint 1")],
        [asdict(run) for run in runs],
    )
