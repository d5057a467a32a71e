"""The ROS 2 messages of the peers over zenoh: their definitions, and the hashes of these, computed here: what ours says is not
asked."""
import hashlib
import json

TIME, HEADER, VECTOR = "builtin_interfaces/msg/Time", "std_msgs/msg/Header", "geometry_msgs/msg/Vector3"
POSE, POINT, QUATERNION = "geometry_msgs/msg/Pose", "geometry_msgs/msg/Point", "geometry_msgs/msg/Quaternion"
TWIST, STAMPED, ODOMETRY = "geometry_msgs/msg/Twist", "geometry_msgs/msg/TwistStamped", "nav_msgs/msg/Odometry"
POSES, TWISTS = "geometry_msgs/msg/PoseWithCovariance", "geometry_msgs/msg/TwistWithCovariance"
WRENCH, TRANSFORM, FRAME = "geometry_msgs/msg/Wrench", "geometry_msgs/msg/Transform", "geometry_msgs/msg/TransformStamped"
VALUE, STATUS = "diagnostic_msgs/msg/KeyValue", "diagnostic_msgs/msg/DiagnosticStatus"
DIMENSION, LAYOUT = "std_msgs/msg/MultiArrayDimension", "std_msgs/msg/MultiArrayLayout"
TRIGGER, EVENT = "std_srvs/srv/Trigger", "service_msgs/msg/ServiceEventInfo"
NOTHING = "uint8 structure_needs_at_least_one_member"
FIELDS = {
    TIME: "int32 sec\nuint32 nanosec",
    HEADER: f"{TIME} stamp\nstring frame_id",
    VECTOR: "float64 x\nfloat64 y\nfloat64 z",
    POINT: "float64 x\nfloat64 y\nfloat64 z",
    QUATERNION: "float64 x\nfloat64 y\nfloat64 z\nfloat64 w",
    POSE: f"{POINT} position\n{QUATERNION} orientation",
    "geometry_msgs/msg/PoseStamped": f"{HEADER} header\n{POSE} pose",
    TWIST: f"{VECTOR} linear\n{VECTOR} angular",
    STAMPED: f"{HEADER} header\n{TWIST} twist",
    POSES: f"{POSE} pose\nfloat64[36] covariance",
    TWISTS: f"{TWIST} twist\nfloat64[36] covariance",
    ODOMETRY: f"{HEADER} header\nstring child_frame_id\n{POSES} pose\n{TWISTS} twist",
    WRENCH: f"{VECTOR} force\n{VECTOR} torque",
    "geometry_msgs/msg/WrenchStamped": f"{HEADER} header\n{WRENCH} wrench",
    "sensor_msgs/msg/JointState": f"{HEADER} header\nstring[] name\nfloat64[] position\nfloat64[] velocity\nfloat64[] effort",
    TRANSFORM: f"{VECTOR} translation\n{QUATERNION} rotation",
    FRAME: f"{HEADER} header\nstring child_frame_id\n{TRANSFORM} transform",
    "tf2_msgs/msg/TFMessage": f"{FRAME}[] transforms",
    VALUE: "string key\nstring value",
    STATUS: f"byte level\nstring name\nstring message\nstring hardware_id\n{VALUE}[] values",
    "diagnostic_msgs/msg/DiagnosticArray": f"{HEADER} header\n{STATUS}[] status",
    DIMENSION: "string label\nuint32 size\nuint32 stride",
    LAYOUT: f"{DIMENSION}[] dim\nuint32 data_offset",
    "std_msgs/msg/Float64MultiArray": f"{LAYOUT} layout\nfloat64[] data",
    "control_msgs/msg/GripperCommand": "float64 position\nfloat64 max_effort",
    "std_msgs/msg/String": "string data",
    "std_msgs/msg/Empty": NOTHING,
    EVENT: f"uint8 event_type\n{TIME} stamp\nuint8[16] client_gid\nint64 sequence_number",
    f"{TRIGGER}_Request": NOTHING,
    f"{TRIGGER}_Response": "bool success\nstring message",
    f"{TRIGGER}_Event": f"{EVENT} info\n{TRIGGER}_Request[<=1] request\n{TRIGGER}_Response[<=1] response",
    TRIGGER: f"{TRIGGER}_Request request_message\n{TRIGGER}_Response response_message\n{TRIGGER}_Event event_message",
}
NUMBERS = {"uint8": 3, "int32": 6, "uint32": 7, "int64": 8, "float64": 11, "bool": 15, "byte": 16, "string": 17}


def used_by(name):
    """Every message within a message."""
    named = {word.partition("[")[0] for word in FIELDS[name].split()} & set(FIELDS)
    return named.union(*map(used_by, named))


def described(name):
    """A message as REP-2016 describes it."""
    fields = []
    for line in FIELDS[name].splitlines():
        kind, field = line.split()
        kind, many, length = kind.partition("[")
        length = length.rstrip("]")
        # One, so many, at most so many, any number.
        number = NUMBERS.get(kind, 1) + (0 if not many else 144 if not length else 96 if length.startswith("<=") else 48)
        fields.append({"name": field, "type": {
            "type_id": number, "capacity": int(length.lstrip("<=") or 0), "string_capacity": 0,
            "nested_type_name": kind if kind in FIELDS else ""}})
    return {"type_name": name, "fields": fields}


def type_hash(name):
    """RIHS01."""
    whole = {"type_description": described(name), "referenced_type_descriptions": [described(part) for part in sorted(used_by(name))]}
    return "RIHS01_" + hashlib.sha256(json.dumps(whole, separators=(", ", ": ")).encode()).hexdigest()


def definition(name):
    """Its text with those of all that is in it: the SDK's own texts are on the network."""
    parts = [f"{'=' * 80}\nMSG: {part}\n{FIELDS[part]}" for part in sorted(used_by(name))]
    return "\n".join([FIELDS[name], *parts])
