"""The ROS 2 messages of the peers, as cyclonedds wants them, with the type names that ROS middlewares give them."""
from dataclasses import dataclass, field, make_dataclass
from cyclonedds.idl import IdlStruct
from cyclonedds.idl.types import array, float64, int32, int64, sequence, uint8, uint32, uint64


def message(type_name, **fields):
    """`message("std_msgs/msg/Header", stamp=Time, frame_id=str)`; every field has a default."""
    package, kind, name = type_name.split("/")

    def default(of):
        if isinstance(of, type) and issubclass(of, IdlStruct):
            return field(default_factory=of)
        if of is str:
            return field(default="")
        if of is bool:
            return field(default=False)
        return field(default=0) if of in (int32, int64, uint8, uint32, uint64) else field(default=0.0) if of is float64 else field(default_factory=list)

    made = make_dataclass(name, [(key, of, default(of)) for key, of in fields.items()], bases=(IdlStruct,))
    made.__idl_typename__ = f"{package}.{kind}.dds_.{name}_"
    return made
