"""What each role may write and read, as Zenoh's access control by the common name of a certificate.

Every role carries the same rules and applies them to whoever is at the other end of a link: what comes in from there
and what goes out to there. Zenoh can tell who sends by certificate and what it sends by key; it cannot tell how many
processes share a certificate, nor look into a message. So one role alone has the right to write `sample`, that of the
source the keys are made for; a second process of that role is refused at its start, by the liveliness token of the
first; and `health`, which every role writes under one key, is believed to be the role's that it names.
"""

from __future__ import annotations

from schemas.messages import OF_DELTA, OF_JOINTS, SAMPLES, TOPICS, Role
from schemas.zenoh_keys import liveliness_key, robot_key, topic_key

SOURCES = (Role.TAP, Role.PLAYER, Role.ROBOT)  # any of them may be the one that writes `sample`
COMMON_NAME = 64  # longest common name of a certificate (RFC 5280, ub-common-name)

_PLANNERS = (Role.PLAYER, Role.ROBOT, Role.MASTER)
_READERS = (Role.MONITOR, Role.OBSERVER)  # of everything
_WRITERS: dict[str, tuple[Role, ...]] = {
    "reference": _PLANNERS,
    "feedforward": (Role.ESTIMATOR,),
    "payload": (Role.ESTIMATOR,),
    "error": (Role.ESTIMATOR,),
    "friction": (Role.ESTIMATOR,),
    "health": tuple(Role),
    "gap": (Role.WATCH,),
    "finding": (Role.WATCH,),
}
_WRITERS |= {joint: _WRITERS[own] for own, joint in zip(OF_DELTA, OF_JOINTS, strict=True) if own in _WRITERS}
_LISTENERS: dict[str, tuple[Role, ...]] = {
    "sample": (Role.ESTIMATOR, Role.WATCH),
    "reference": (Role.ESTIMATOR,),
    "payload": (Role.WATCH,),
    "feedforward": (Role.ROBOT, Role.MASTER),
}
_LISTENERS |= {joint: _LISTENERS[own] for own, joint in zip(OF_DELTA, OF_JOINTS, strict=True) if own in _LISTENERS}


def common_name(robot: str | None, role: Role) -> str:
    """The common name of the certificate of `role`; `robot` None stands for every robot."""
    return f"deltatwin/{robot or '*'}/{role.name.lower()}"


def writers(topic: str, source: Role) -> tuple[Role, ...]:
    """Roles that may write `topic`, one of `schemas.messages.TOPICS`, where `source` is the one that writes samples."""
    return (source,) if topic in SAMPLES else _WRITERS[topic]


def readers(topic: str) -> tuple[Role, ...]:
    """Roles that may read `topic`, one of `schemas.messages.TOPICS`."""
    return (*_LISTENERS.get(topic, ()), *_READERS)


def access_control(robot: str | None, source: Role) -> dict:
    """The `access_control` section of a Zenoh configuration, the same for every role."""

    def key(topic: str) -> str:
        return topic_key(robot, topic) if robot else f"deltatwin/*/{topic}"

    def token(role: Role) -> str:
        return liveliness_key(robot, role) if robot else f"deltatwin/*/@/{role.name.lower()}"

    everything = [key(topic) for topic in TOPICS]
    tokens = [token(role) for role in Role] + [f"deltatwin/{robot_key(robot) if robot else '*'}/@/*"]
    rules = [
        _rule("watches tokens", ["declare_liveliness_subscriber", "liveliness_query"], ["ingress", "egress"], tokens),
        _rule("hears tokens", ["liveliness_token"], ["egress"], tokens),
        _rule("is asked", ["declare_subscriber"], ["egress"], everything),
    ]
    policies = []
    for role in Role:
        name = role.name.lower()
        written = [key(topic) for topic in TOPICS if role in writers(topic, source)]
        read = [key(topic) for topic in TOPICS if role in readers(topic)]
        own = [_rule(f"{name} is alive", ["liveliness_token"], ["ingress"], [token(role)])]
        own.append(_rule(f"{name} writes", ["put"], ["ingress"], written))
        if read:
            own.append(_rule(f"{name} reads", ["declare_subscriber"], ["ingress"], read))
            own.append(_rule(f"{name} is sent", ["put"], ["egress"], read))
        rules += own
        policies.append(
            {"subjects": [name], "rules": ["watches tokens", "hears tokens", "is asked", *(rule["id"] for rule in own)]}
        )
    return {
        "enabled": True,
        "default_permission": "deny",
        "rules": rules,
        "subjects": [{"id": role.name.lower(), "cert_common_names": [common_name(robot, role)]} for role in Role],
        "policies": policies,
    }


def _rule(name: str, messages: list[str], flows: list[str], keys: list[str]) -> dict:
    return {"id": name, "permission": "allow", "messages": messages, "flows": flows, "key_exprs": keys}
