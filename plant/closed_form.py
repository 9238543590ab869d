"""Straight-line source text of the planar arm's rigid-body dynamics, for a number of joints and a set of free ones.

Loops over lists cost five times as much in scalar Python, numpy on 3 x 3 fifteen times; hence text, compiled once.
Symbols: t_i = q_1 + .. + q_i the absolute angle from the horizontal, v_i its speed, A_ij and G_i constants of the links
(`constants`), J_i rotor inertia, D_i viscosity. In absolute angles

    M_ij = A_ij cos(t_i - t_j)    h_i = sum_j A_ij sin(t_i - t_j) v_j^2    g_i = G_i cos t_i

and the joint coordinates' values are the sums over all links from joint i (and j) on; J_i stands on M's diagonal there.
The text uses floats, tuples, sin and cos alone, so Numba compiles it too. Units: SI. Ref: eq. (1).
"""

from functools import cache

from plant.contact import Lines, contact_lines
from plant.parameters import ArmParameters, check_payload


def constants(parameters: ArmParameters, payload_kg: float) -> dict[str, float]:
    """Return A_ij (i <= j), G_i, J_i, D_i by the text's names: uniform links, a point mass payload_kg at the tip."""
    values: dict[str, float] = {}
    beyond = check_payload(payload_kg)  # mass beyond link j
    for j in range(parameters.joints, 0, -1):
        length, mass = parameters.length_m[j - 1], parameters.mass_kg[j - 1]
        moment = (mass / 2 + beyond) * length
        values[f"A{j}{j}"] = (mass / 3 + beyond) * length * length
        for i in range(1, j):
            values[f"A{i}{j}"] = parameters.length_m[i - 1] * moment
        values[f"G{j}"] = parameters.gravity_m_s2 * moment
        values[f"J{j}"] = parameters.rotor_inertia_kgm2[j - 1]
        values[f"D{j}"] = parameters.viscosity_Nms[j - 1]
        beyond += mass
    return values


def each(n: int, pattern: str) -> str:
    """Return the pattern for i = 1..n, with a comma after each: `each(2, "q{i}")` is "q1, q2,"."""
    return " ".join(pattern.format(i=i) + "," for i in range(1, n + 1))


def inertia_lines(n: int) -> Lines:
    """Set M_ij (i <= j), and S_ij = A_ij sin(t_j - t_i) for `bias_lines`, from q_i."""
    lines = []
    for i in range(1, n):
        lines += [f"d{i}{i + 1} = q{i + 1}"]
        lines += [f"d{i}{j} = d{i}{j - 1} + q{j}" for j in range(i + 2, n + 1)]
        lines += [f"S{i}{j} = A{i}{j} * sin(d{i}{j})" for j in range(i + 1, n + 1)]
    for i in range(n, 0, -1):
        row = ""
        for j in range(n, i, -1):
            row = f"{row} + A{i}{j} * cos(d{i}{j})" if row == "" else f" + r{i}{j + 1} + A{i}{j} * cos(d{i}{j})"
            lines += [f"r{i}{j} ={row.removeprefix(' +')}", f"m{i}{j} = m{i + 1}{j} + r{i}{j}"]
        lines.append(f"m{i}{i} = A{i}{i}" if i == n else f"m{i}{i} = m{i}{i + 1} + r{i}{i + 1} + A{i}{i}")
    return lines + [f"M{i}{i} = m{i}{i} + J{i}" for i in range(1, n + 1)]


def bias_lines(n: int, coriolis: bool = True, gravity: bool = True) -> Lines:
    """Set b_i to the joint torque of h, of g, or of both; after `inertia_lines`."""
    lines = [f"t{i} = {f't{i - 1} + q{i}' if i > 1 else 'q1'}" for i in range(1, n + 1) if gravity]
    for i in range(1, n + 1):
        lines += [f"v{i} = {f'v{i - 1} + w{i}' if i > 1 else 'w1'}", f"p{i} = v{i} * v{i}"] if coriolis else []
    for i in range(n, 0, -1):
        terms = [f"+ b{i + 1}"] if i < n else []
        terms += [f"+ G{i} * cos(t{i})"] if gravity else []
        if coriolis:
            terms += [f"+ S{j}{i} * p{j}" for j in range(1, i)] + [f"- S{i}{j} * p{j}" for j in range(i + 1, n + 1)]
        lines.append(f"b{i} = {' '.join(terms).removeprefix('+ ') or '0.0'}")
    return lines


def solve_lines(free: tuple[int, ...]) -> Lines:
    """Set x_i of the free joints (numbered from 1) so that M x = y over them alone, by unrolled L D L^T."""
    lines = []
    for place, k in enumerate(free):
        above = free[:place]
        for m in free[place:]:  # u_km = column k of what elimination has left of row m
            cut = "".join(f" - L{k}_{p} * U{p}_{m}" for p in above)
            lines.append(f"U{k}_{m} = {_entry(k, m)}{cut}")
        lines += [f"L{m}_{k} = U{k}_{m} / U{k}_{k}" for m in free[place + 1 :]]
        lines += [f"y{k} = y{k}{''.join(f' - L{k}_{p} * y{p}' for p in above)}"] if above else []
    for place in range(len(free) - 1, -1, -1):
        k = free[place]
        cut = "".join(f" - L{m}_{k} * x{m}" for m in free[place + 1 :])
        lines.append(f"x{k} = y{k} / U{k}_{k}{cut}")
    return lines


def _entry(i: int, j: int) -> str:
    return f"M{i}{i}" if i == j else f"m{min(i, j)}{max(i, j)}"


def unpack_lines(n: int, **sources: str) -> Lines:
    """Set x1 .. xn from the tuple of that name, for each x=tuple."""
    return [f"{each(n, symbol + '{i}')} = {name}" for symbol, name in sources.items()]


def driving_lines(joints: tuple[int, ...], ripple: bool) -> Lines:
    """Set f_i = Kt(q) i_i + e_i; the drive's constants are K_i, E_i, O_i (`drive.torque_constant`)."""
    factor = " * (1.0 + E{i} * cos(O{i} * q{i}))" if ripple else ""
    return [("f{i} = K{i}" + factor + " * i{i} + e{i}").format(i=i) for i in joints]


def acceleration_lines(n: int, free: tuple[int, ...]) -> Lines:
    """Set x_i = q" of the free joints from q_i, w_i and the torque f_i (that of motor, friction and outside)."""
    right = [f"y{i} = f{i} - D{i} * w{i} - b{i}" for i in free]
    return [*inertia_lines(n), *bias_lines(n), *right, *solve_lines(free)]


@cache
def terms_text(n: int) -> str:
    """Return the text of terms(q, w) -> (M, h, g)."""
    rows = " ".join("(" + " ".join(_entry(i, j) + "," for j in range(1, n + 1)) + ")," for i in range(1, n + 1))
    body = [*unpack_lines(n, q="q", w="w"), *inertia_lines(n)]
    body += [*bias_lines(n, gravity=False), f"h = ({each(n, 'b{i}')})"]
    body += [*bias_lines(n, coriolis=False), f"return ({rows}), h, ({each(n, 'b{i}')})"]
    return function_text("terms(q, w)", body)


@cache
def inverse_dynamics_text(n: int) -> str:
    """Return the text of inverse_dynamics(q, w, a) -> M a + h + g + D w."""
    joints = tuple(range(1, n + 1))
    body = [*unpack_lines(n, q="q", w="w", x="a"), *inertia_lines(n), *bias_lines(n)]
    sums = [f"{_row(i, joints)}D{i} * w{i} + b{i}," for i in joints]
    return function_text("inverse_dynamics(q, w, a)", [*body, f"return ({' '.join(sums)})"])


@cache
def acceleration_text(n: int, free: tuple[int, ...]) -> str:
    """Return the text of acceleration(q, w, torque) -> q", 0.0 for joints that are not free."""
    body = [*unpack_lines(n, q="q", w="w", f="torque"), *acceleration_lines(n, free)]
    return function_text("acceleration(q, w, torque)", [*body, f"return ({_of_free(n, free)})"])


@cache
def balance_text(n: int, free: tuple[int, ...], ripple: bool, surfaces: int = 0) -> str:
    """Return the text of balance(q, w, current, e) -> (q", what holds the joints that are not free, else 0.0).

    With surfaces near the tip they are a further argument.
    """
    joints = tuple(range(1, n + 1))
    body = [*unpack_lines(n, q="q", w="w", i="current", e="e"), *driving_lines(joints, ripple)]
    body += [*contact_lines(n, joints, surfaces, ""), *acceleration_lines(n, free)]
    held = "".join("0.0, " if i in free else f"f{i} - ({_row(i, free)}b{i}), " for i in range(1, n + 1))
    signature = f"balance(q, w, current, e{', surfaces' if surfaces else ''})"
    return function_text(signature, [*body, f"return ({_of_free(n, free)}), ({held})"])


@cache
def touch_text(n: int, surfaces: int) -> str:
    """Return the text of touch(q, w, surfaces) -> (joint torques of the contact, (depth, F_n, F_t) of each surface)."""
    joints = tuple(range(1, n + 1))
    body = [*unpack_lines(n, q="q", w="w"), *(f"f{i} = 0.0" for i in joints)]
    body += contact_lines(n, joints, surfaces, "")
    touches = " ".join(f"(max(0.0, -gap{k}), push{k}, rub{k})," for k in range(surfaces))
    return function_text("touch(q, w, surfaces)", [*body, f"return ({each(n, 'f{i}')}), ({touches})"])


def _row(i: int, joints: tuple[int, ...]) -> str:
    return "".join(f"{_entry(i, j)} * x{j} + " for j in joints)


def _of_free(n: int, free: tuple[int, ...]) -> str:
    return "".join(f"x{i}, " if i in free else "0.0, " for i in range(1, n + 1))


def function_text(signature: str, body: Lines) -> str:
    """Return a function definition."""
    return "\n".join([f"def {signature}:", *indented(body), ""])


def indented(lines: Lines) -> Lines:
    """Return the lines one block further in."""
    return ["    " + line for line in lines]
