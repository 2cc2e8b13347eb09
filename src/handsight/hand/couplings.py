"""Coupled joints: those that a hand does not drive by themselves, as a linkage or a tendon makes them follow another.

A URDF says it by `<mimic>`, an MJCF by `<equality>` between two joints or by a fixed tendon of constant length. Drivers
of such hands publish the driven joints only; the others are computed from them.
"""

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.polynomial import Polynomial

from handsight.checks import Array
from handsight.hand.robot_xml import Element

COUNTS_AS_DRIVEN = ", and counts as driven by itself"
Law = Polynomial
"""The position of a joint by that of its leader [rad], for slides [m]."""


@dataclass(frozen=True, slots=True, eq=False)
class Coupling:
    """A joint that follows another one, as a file says."""

    joint: str
    leader: str  # empty: the joint has a constant position
    law: Law


@dataclass(frozen=True)
class Couplings:
    """All coupled joints of a hand, each by the driven joint that it follows in the end."""

    laws: Mapping[str, tuple[str, Law]]
    """By coupled joint: its driven joint, and its position by that one's; without a joint its position is constant."""

    @classmethod
    def of(cls, couplings: Iterable[Coupling]) -> "tuple[Couplings, list[str]]":
        """Returns the couplings of a file, chains of them resolved, and a sentence for each that cannot be: joints that
        follow two others, or each other in a circle, count as driven."""
        direct = dict[str, Coupling]()
        several = dict[str, list[str]]()
        for each in couplings:
            if each.joint in direct:
                several.setdefault(each.joint, [direct[each.joint].leader]).append(each.leader)
            direct[each.joint] = each
        left_out = list[str]()
        for name, leaders in several.items():
            del direct[name]
            left_out.append(f"joint {name!r} follows {' and '.join(map(repr, leaders))}{COUNTS_AS_DRIVEN}")
        for circle in dict.fromkeys(_circle(name, direct) for name in direct):
            for name in circle:
                del direct[name]
            if circle:
                named = ", ".join(map(repr, sorted(circle)))
                left_out.append(f"joints {named} follow each other in a circle{COUNTS_AS_DRIVEN}")
        return cls({name: _resolved(name, direct) for name in direct}), left_out

    def leaders(self, joints: Iterable[str]) -> tuple[str, ...]:
        """Returns the joints, each coupled one replaced by that which it follows, each once."""
        found = dict[str, None]()
        for name in joints:
            leader, _ = self.laws.get(name, (name, None))
            if leader:
                found[leader] = None
        return tuple(found)

    def completed(self, joint_positions: Mapping[str, float]) -> Mapping[str, float]:
        """Returns joint positions with those of coupled joints that are not in them; a position that is in them, as it
        was measured, stays."""
        missing = dict[str, float]()
        for name, (leader, law) in self.laws.items():
            known = not leader or leader in joint_positions
            if known and name not in joint_positions:
                lead = joint_positions.get(leader, 0.0)
                missing[name] = float(law(lead))
        return {**joint_positions, **missing} if missing else joint_positions

    def changes(self, joints: Sequence[str], positions: Mapping[str, float]) -> Array:
        """Returns the derivative (j, j) of the joints' positions by those of the driven ones among them, and by how far
        each coupled one is off its law, which is its own column.

        `positions`: those that were measured; a coupled joint that is among them follows none.
        """
        S = np.eye(len(joints))
        place = {name: i for i, name in enumerate(joints)}
        for name, (leader, law) in self.laws.items():
            if name in positions or name not in place or leader not in place:
                continue
            slope = law.deriv()
            lead = positions.get(leader, 0.0)
            S[place[name], place[leader]] = slope(lead)
        return S


def _circle(name: str, direct: Mapping[str, Coupling]) -> frozenset[str]:
    """Returns the joints of the circle in which the way from a joint to its leader, and on to that one's, ends; none
    where it ends in a joint that follows none."""
    way = list[str]()
    at = name
    while at in direct and at not in way:
        way.append(at)
        at = direct[at].leader
    return frozenset(way[way.index(at) :] if at in way else ())


def _resolved(name: str, direct: Mapping[str, Coupling]) -> tuple[str, Law]:
    """Returns the driven joint that a joint follows in the end, empty where there is none, and its position by that
    one's."""
    leader, law = direct[name].leader, direct[name].law
    while leader in direct:
        law = law(direct[leader].law)
        leader = direct[leader].leader
    return leader, law


def of_urdf(joints: Iterable[Element]) -> Iterator[Coupling]:
    """Yields the couplings of a URDF's `<joint>` elements; raises InvalidFile."""
    joints = list(joints)
    kinds = {joint.get("name"): joint.get("type") for joint in joints}
    for joint in joints:
        mimic = joint.find("mimic")
        if mimic is None:
            continue
        leader = mimic.get("joint")
        if leader not in kinds:
            continue  # then it is a joint like others, and its position is asked for
        offset = _numbers(mimic, "offset") or [0.0]
        multiplier = _numbers(mimic, "multiplier") or [1.0]
        law = Law([*offset, *multiplier])
        if kinds[leader] == "fixed":  # which is always at 0
            yield Coupling(joint.get("name"), "", Law([law(0.0)]))
        elif kinds[joint.get("name")] != "fixed":
            yield Coupling(joint.get("name"), leader, law)


def of_mjcf(
    constraints: Iterable[Element], tendons: Iterable[Element], zeros: Mapping[str, float]
) -> Iterator[Coupling]:
    """Yields the couplings of an MJCF's `<joint>` and `<tendon>` elements in `<equality>`, and of its fixed tendons.

    `zeros`: by joint, its position in the reference pose (MuJoCo's `qpos0`), in the order of the file. Others than of
    one joint or between two say of no joint alone where it is, and are left out. Raises InvalidFile.
    """
    by_name = {tendon.get("name"): tendon for tendon in tendons}
    for constraint in constraints:
        if constraint.get("active") == "false":
            continue
        law = Law(_numbers(constraint, "polycoef") or [0.0, 1.0])
        if constraint.tag == "joint":
            yield from _of_joints(constraint.get("joint1"), constraint.get("joint2"), law, zeros)
            continue
        tendon = by_name.get(constraint.get("tendon1"))
        if tendon is not None and not constraint.get("tendon2"):
            yield from _of_tendon(tendon, law.coef[0], zeros)


def _of_joints(joint: str, leader: str, law: Law, zeros: Mapping[str, float]) -> Iterator[Coupling]:
    """Yields the coupling of an MJCF's `<joint>` in `<equality>`, whose law is between distances from the reference."""
    if joint not in zeros:
        return
    if not leader:
        yield Coupling(joint, "", Law([law.coef[0] + zeros[joint]]))
    elif leader in zeros:
        from_reference = Law([-zeros[leader], 1.0])
        yield Coupling(joint, leader, law(from_reference) + zeros[joint])


def _of_tendon(tendon: Element, longer: float, zeros: Mapping[str, float]) -> Iterator[Coupling]:
    """Yields the coupling of a fixed tendon around two joints, whose length is constant: that in the reference pose,
    and so much `longer`."""
    ends = {end.get("joint"): sum(_numbers(end, "coef")) for end in tendon.all("joint")}
    usable = all(name in zeros and coef for name, coef in ends.items())
    if len(ends) != 2 or not usable:
        return
    order = list(zeros)
    leader, joint = sorted(ends, key=order.index)
    length = longer + sum(coef * zeros[name] for name, coef in ends.items())
    taken = Law([length, -ends[leader]])
    yield Coupling(joint, leader, taken / ends[joint])


def _numbers(element: Element, name: str) -> list[float]:
    """Returns the numbers of an attribute, none where there is none; raises InvalidFile for others than numbers."""
    text = element.get(name)
    try:
        numbers = [float(word) for word in text.split()]
    except ValueError:
        numbers = [math.nan]
    if not all(map(math.isfinite, numbers)):
        raise element.error(f"{element.tag}: expected numbers as {name}, got {text!r:.80}")
    return numbers
