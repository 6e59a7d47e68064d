"""RTDE on the wire, seen from the controller: frames, variables, recipes (UR's public protocol)."""

import struct
from dataclasses import dataclass, field

HEADER = struct.Struct(">HB")
FORMATS = {
    "BOOL": "?", "UINT8": "B", "UINT32": "I", "UINT64": "Q", "INT32": "i", "DOUBLE": "d",
    "VECTOR3D": "3d", "VECTOR6D": "6d", "VECTOR6INT32": "6i", "VECTOR6UINT32": "6I",
}  # fmt: skip
OUTPUTS = {
    "timestamp": "DOUBLE", "robot_status_bits": "UINT32", "safety_status_bits": "UINT32",
    "runtime_state": "UINT32", "actual_TCP_pose": "VECTOR6D", "actual_TCP_speed": "VECTOR6D",
    "target_TCP_pose": "VECTOR6D", "target_TCP_speed": "VECTOR6D", "actual_q": "VECTOR6D",
    "actual_qd": "VECTOR6D", "robot_mode": "INT32", "safety_mode": "INT32",
    "speed_scaling": "DOUBLE", "payload": "DOUBLE", "payload_cog": "VECTOR3D",
    "payload_inertia": "VECTOR6D",
}  # fmt: skip


def kind(name: str) -> str:
    """Return the type of a variable, NOT_FOUND for an unknown one."""
    for part, found in (("_int_register_", "INT32"), ("_double_register_", "DOUBLE")):
        if part in name:
            return found
    if name == "external_force_torque":
        return "VECTOR6D"
    return OUTPUTS.get(name, "NOT_FOUND")


@dataclass
class Recipe:
    """The order in which variables stand in a data package."""

    names: list[str]
    kinds: list[str] = field(init=False)
    packing: struct.Struct = field(init=False)

    def __post_init__(self) -> None:
        self.kinds = [kind(name) for name in self.names]
        self.packing = struct.Struct(">" + "".join(FORMATS.get(k, "") for k in self.kinds))

    def pack(self, values: dict[str, object]) -> bytes:
        """Return the values in order; a variable without one is zero."""
        flat: list[object] = []
        for name, of_kind in zip(self.names, self.kinds, strict=True):
            count = int(FORMATS[of_kind][:-1] or 1)
            value = values.get(name, [0] * count if count > 1 else 0)
            flat += list(value) if count > 1 else [value]  # type: ignore[call-overload]
        return self.packing.pack(*flat)

    def unpack(self, payload: bytes) -> dict[str, object]:
        """Return scalar variables by name."""
        return dict(zip(self.names, self.packing.unpack(payload), strict=False))


def recipe_of(listed: str) -> Recipe:
    """Return the recipe for a comma list.

    Clients end the list with a comma; a controller passes over the empty name. One that answered
    NOT_FOUND to it would make ur_rtde crash.
    """
    return Recipe([name for name in listed.split(",") if name])


def frame(letter: str, payload: bytes = b"") -> bytes:
    """Return one RTDE package."""
    return HEADER.pack(len(payload) + HEADER.size, ord(letter)) + payload
