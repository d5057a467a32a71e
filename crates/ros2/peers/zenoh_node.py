"""A node over rmw_zenoh, by zenoh-ros2-sdk: one in a process."""
import xxhash
from zenoh_ros2_sdk import ROS2Publisher, ROS2ServiceClient, ROS2Subscriber
from zenoh_ros2_sdk.entity import EndpointEntity, EntityKind, NodeEntity
from zenoh_ros2_sdk.keyexpr import endpoint_liveliness_keyexpr
from zenoh_ros2_sdk.qos import QosDurability, QosProfile

from zenoh_messages import NOTHING, FIELDS, TRIGGER, definition, type_hash


class ZenohNode:
    def __init__(self, port, domain, name="user"):
        self.where, self.calls = dict(node_name=name, domain_id=domain, router_port=port), {}

    def of(self, name):
        return dict(msg_type=name, msg_definition=definition(name), type_hash=type_hash(name), **self.where)

    def made(self, name, *fields):
        """A message of that type; one that nobody reads or writes has no class yet."""
        return self.session.store.types[name](*fields)

    def reader(self, topic, name, latched=False):
        """What has come since it was asked last, oldest first, as a function."""
        unread, qos = [], QosProfile(durability=QosDurability.TRANSIENT_LOCAL) if latched else None
        self.session = ROS2Subscriber(topic, callback=unread.append, qos=qos, **self.of(name)).session_mgr

        def take():
            taken = unread[:]
            del unread[:len(taken)]
            return taken
        return take

    def writer(self, topic, name):
        """A function that sends."""
        writer = ROS2Publisher(topic, **self.of(name))
        self.session, writer.publisher_gid = writer.session_mgr, number(writer)
        return lambda message: writer.publish(**vars(message))

    def call(self, service):
        """Calls a trigger, and waits for its answer."""
        if service not in self.calls:
            self.calls[service] = ROS2ServiceClient(
                service, TRIGGER, request_definition=NOTHING, response_definition=FIELDS[f"{TRIGGER}_Response"],
                type_hash=type_hash(TRIGGER), **self.where)
        answer = self.calls[service].call(structure_needs_at_least_one_member=0)
        assert answer is not None, f"no answer of {service}"
        return answer.success, answer.message


def number(writer):
    """That of a writer of rmw_zenoh_cpp: XXH3-128 of its token, low half first. The SDK's are random."""
    node = NodeEntity(domain_id=writer.domain_id, session_id=writer.session_mgr.session_id, node_id=writer.node_id,
                      node_name=writer.node_name, namespace=writer.namespace)
    end = EndpointEntity(node=node, entity_id=writer.entity_id, kind=EntityKind.PUBLISHER, name=writer.topic,
                         dds_type_name=writer.dds_type_name, type_hash=writer.type_hash, qos=writer.qos, gid=writer.publisher_gid)
    return xxhash.xxh3_128_intdigest(endpoint_liveliness_keyexpr(end).encode()).to_bytes(16, "little")
