"""What of a scenario's world cannot be: things inside each other at the start, grasps out of order.

Raises ScenarioError with the thing, its value, the limit and the cure. Units: m, s.
"""

from itertools import pairwise

from hil.errors import ScenarioError
from hil.scenario import Scenario, check_interval
from hil.scenario_world import Grasp, Wall
from plant.kinematics import joint_points

TOUCHING_M = 1e-6
"""Bodies may lie on a wall, and overlap it by rounding."""

Point = tuple[float, float]
Rectangle = tuple[Point, tuple[float, float]]
"""(centre, (width, height)), upright."""


def check_world(scenario: Scenario) -> None:
    """Refuse walls, boxes and payloads that cannot be where they are, and grasps that cannot follow each other."""
    bodies = _bodies(scenario)
    for k, wall in enumerate(scenario.wall):
        if wall.normal == (0.0, 0.0):
            raise ScenarioError(f"wall.{k}.normal = [0, 0] has no direction: give the one that leaves the wall")
        _check_arm_in_front(scenario, k, wall)
        for name, rectangle in bodies.items():
            _check_body_in_front(name, rectangle, k, wall)
    _check_bodies_apart(bodies)
    _check_links_clear(scenario)
    _check_grasps(scenario)


def _bodies(scenario: Scenario) -> dict[str, Rectangle]:
    found: dict[str, Rectangle] = {}
    if scenario.box is not None:
        found["box"] = scenario.box.position_m, scenario.box.size_m
    for k, grasp in enumerate(scenario.grasp):
        found[f"grasp.{k}"] = grasp.position_m, (grasp.size_m, grasp.size_m)
    return found


def _gap_m(wall: Wall, point: Point) -> float:
    nx, ny = wall.normal
    along = nx * (point[0] - wall.point_m[0]) + ny * (point[1] - wall.point_m[1])
    return float(along / (nx**2 + ny**2) ** 0.5)


def _check_arm_in_front(scenario: Scenario, k: int, wall: Wall) -> None:
    points = joint_points(scenario.arm.lengths_m, scenario.start_rad)
    names = ["the base", *(f"joint {n}" for n in range(2, len(points))), "the tip"]
    for name, point in zip(names, points, strict=True):
        gap_m = _gap_m(wall, point)
        if gap_m < 0.0 or (gap_m == 0.0 and name != "the base"):  # the base may stand on it
            raise ScenarioError(
                f"wall.{k}: at start_rad {name} is at ({point[0]:.4f}, {point[1]:.4f}) m, {-gap_m:.4f} m behind it, "
                "but the arm must begin in front of it: move point_m, turn normal round, or change start_rad"
            )


def _check_body_in_front(name: str, rectangle: Rectangle, k: int, wall: Wall) -> None:
    depth_m = max(-_gap_m(wall, corner) for corner in _corners(rectangle))
    if depth_m > TOUCHING_M:
        raise ScenarioError(
            f"{name}.position_m = {list(rectangle[0])}: it lies {depth_m:.4f} m inside wall.{k}, "
            "but it may only touch it: move one of them"
        )


def _check_bodies_apart(bodies: dict[str, Rectangle]) -> None:
    names = list(bodies)
    for place, name in enumerate(names):
        for other in names[place + 1 :]:
            overlaps = [
                (bodies[name][1][axis] + bodies[other][1][axis]) / 2
                - abs(bodies[name][0][axis] - bodies[other][0][axis])
                for axis in (0, 1)
            ]
            if min(overlaps) > TOUCHING_M:
                raise ScenarioError(f"{name} and {other} overlap by {min(overlaps):.4f} m: move one of them")


def _check_links_clear(scenario: Scenario) -> None:
    if scenario.box is None:
        return
    points = joint_points(scenario.arm.lengths_m, scenario.start_rad)
    box = scenario.box
    for link, (start, end) in enumerate(pairwise(points), start=1):
        if _crosses(start, end, (box.position_m, box.size_m)):
            raise ScenarioError(
                f"box.position_m = {list(box.position_m)}: at start_rad link {link} from "
                f"({start[0]:.4f}, {start[1]:.4f}) to ({end[0]:.4f}, {end[1]:.4f}) m touches the box, "
                "but it must be clear of it: move the box or the arm"
            )


def _check_grasps(scenario: Scenario) -> None:
    free_s = 0.0
    for k, grasp in sorted(enumerate(scenario.grasp), key=_begins):
        check_interval(f"grasp.{k}", grasp.at_s, grasp.until_s, scenario)
        if grasp.at_s < free_s:
            raise ScenarioError(
                f"grasp.{k}.at_s = {grasp.at_s}: the hand holds another payload until {free_s} s, and one at a time: "
                "let it close later"
            )
        free_s = grasp.until_s


def _begins(numbered: tuple[int, Grasp]) -> float:
    return numbered[1].at_s


def _corners(rectangle: Rectangle) -> list[Point]:
    (x, y), (width, height) = rectangle
    return [(x + a * width / 2, y + b * height / 2) for a in (-1, 1) for b in (-1, 1)]


def _crosses(start: Point, end: Point, rectangle: Rectangle) -> bool:
    """Return whether a segment meets a rectangle (Liang and Barsky's clipping)."""
    low, high = 0.0, 1.0
    for axis in (0, 1):
        way = end[axis] - start[axis]
        half = rectangle[1][axis] / 2
        near, far = (rectangle[0][axis] + side * half - start[axis] for side in (-1, 1))
        if way == 0.0:
            if near > 0.0 or far < 0.0:
                return False
            continue
        enters, leaves = sorted((near / way, far / way))
        low, high = max(low, enters), min(high, leaves)
    return low <= high
