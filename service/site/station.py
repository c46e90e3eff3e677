"""A cell on the bus: a liveliness token, publishers, and answers. No subscriber: nothing said to it is heard."""

from collections import OrderedDict
from collections.abc import Mapping
from typing import Self

import zenoh
from zenoh.ext import (
    AdvancedPublisher,
    CacheConfig,
    MissDetectionConfig,
    declare_advanced_publisher,
)

from cellcal.calibration.message import make_message
from cellcal.drivers.supervision import SUPERVISOR
from cellcal.service.site.answers import QUERY_PARAMETERS, CellAnswers, as_error
from cellcal.service.site.keys import SiteError, StationKeys
from cellcal.service.site.link_files import close_session
from cellcal.service.site.outbox import SentEvent, SiteOutbox
from cellcal.service.site.signed_messages import ENCODING, MessageSigner

_HEARTBEAT_S = 0.5
_EVENTS_CACHED = 1000
_SESSIONS_OPEN = 8  # runs whose publisher is kept; older ones are mended from the outbox
_BLOCK, _DROP = zenoh.CongestionControl.BLOCK, zenoh.CongestionControl.DROP


class Station:
    """Publishes what it is given; answers what it is asked."""

    def __init__(
        self,
        config: zenoh.Config,
        keys: StationKeys,
        sealer: MessageSigner,
        outbox: SiteOutbox,
        answers: CellAnswers,
    ) -> None:
        self._keys, self._sealer, self._outbox, self._answers = keys, sealer, outbox, answers
        self._session = zenoh.open(config)
        self._token = self._session.liveliness().declare_token(keys.alive_key)
        self._state = advanced_publisher(self._session, keys.state_key, 1)
        self._alarm = advanced_publisher(
            self._session,
            keys.alarm_key,
            _EVENTS_CACHED,
            _BLOCK,
            zenoh.Priority.INTERACTIVE_HIGH,
            heartbeat=True,
        )
        self._values: dict[str, zenoh.Publisher] = {}
        self._latest: dict[str, AdvancedPublisher] = {}
        self._events: OrderedDict[str, AdvancedPublisher] = OrderedDict()
        self._queryables = [
            self._session.declare_queryable(keys.answer_key("*"), self._on_query),
            self._session.declare_queryable(keys.certificate_key("*"), self._on_certificate_query),
        ]

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Leave the bus. Without it the process would not end."""
        close_session(self._session)

    @property
    def is_linked(self) -> bool:
        """Whether a router is connected."""
        return bool(self._session.info.routers_zid())

    def publish_state(self, body: Mapping[str, object]) -> None:
        """Publish how the cell stands."""
        self._state.put(self._sign_live(self._keys.state_key, body), encoding=ENCODING)

    def publish_value(self, key: str, body: Mapping[str, object]) -> None:
        """Publish a value that the next one replaces; lost where the link is."""
        if key not in self._values:  # declared, so that the router knows the way of each sample beforehand
            self._values[key] = self._session.declare_publisher(
                key, encoding=ENCODING, congestion_control=_DROP
            )
        self._values[key].put(self._sign_live(key, body))

    def publish_latest(self, key: str, body: Mapping[str, object]) -> None:
        """Publish a value that later subscribers must receive, too."""
        if key not in self._latest:
            self._latest[key] = advanced_publisher(self._session, key, 1)
        self._latest[key].put(self._sign_live(key, body), encoding=ENCODING)

    def publish_event(self, sent: SentEvent) -> None:
        """Publish an event of the outbox."""
        publisher = self._alarm if sent.key == self._keys.alarm_key else self._publisher_of(sent.key)
        publisher.put(sent.message, encoding=ENCODING)

    def _sign_live(self, key: str, body: Mapping[str, object]) -> bytes:
        return self._sealer.sign_message(key, self._outbox.next_live(), body)

    def _publisher_of(self, key: str) -> AdvancedPublisher:
        if key not in self._events:
            self._events[key] = advanced_publisher(self._session, key, _EVENTS_CACHED, _BLOCK, heartbeat=True)
            while len(self._events) > _SESSIONS_OPEN:
                self._events.popitem(last=False)[1].undeclare()  # type: ignore[no-untyped-call]  # zenoh
        self._events.move_to_end(key)
        return self._events[key]

    # questions; these run in zenoh's threads, where an exception would only be printed

    def _on_query(self, query: zenoh.Query) -> None:
        verb = str(query.key_expr).rpartition("/")[2]
        key = self._keys.answer_key(verb)
        try:
            if "*" in verb:
                raise SiteError(f"ask for one verb: {', '.join(self._answers.verbs)}.")
            parameters = {name: query.parameters.get(name) for name in QUERY_PARAMETERS}
            arguments = {name: value for name, value in parameters.items() if value is not None}
            for answer in self._answers.answer_query(verb, arguments):
                query.reply(
                    key,
                    answer if isinstance(answer, bytes) else self._sign_live(key, answer),
                    encoding=ENCODING,
                )
        except SiteError as error:
            query.reply_err(as_error(error))
        except Exception as error:  # noqa: BLE001  in zenoh's thread it would only be printed
            SUPERVISOR.note_failure(
                make_message("answers to the site: {verb}", verb=verb), error, running=True
            )
            query.reply_err(as_error(SiteError(f"the cell cannot read its records: {error}.")))

    def _on_certificate_query(self, query: zenoh.Query) -> None:
        run_id = str(query.key_expr).rpartition("/")[2]
        try:
            query.reply(self._keys.certificate_key(run_id), self._answers.read_certificate(run_id))
        except SiteError as error:
            query.reply_err(as_error(error))
        except Exception as error:  # noqa: BLE001  in zenoh's thread it would only be printed
            SUPERVISOR.note_failure("answers to the site: certificates", error, running=True)
            query.reply_err(as_error(SiteError("the cell cannot read its certificate just now.")))


def advanced_publisher(
    session: zenoh.Session,
    key: str,
    cached: int,
    congestion: zenoh.CongestionControl = _DROP,
    priority: zenoh.Priority = zenoh.Priority.DATA,
    *,
    heartbeat: bool = False,
) -> AdvancedPublisher:
    """Declare a publisher that numbers what it says and remembers the newest of it.

    What an advanced subscriber listens to must be numbered: plain samples are told apart by the router's time
    stamps, and one that two of its threads pass on in another order than they stamped it is dropped as old.
    """
    beat_s = _HEARTBEAT_S if heartbeat else None
    return declare_advanced_publisher(
        session,
        key,
        congestion_control=congestion,
        priority=priority,
        cache=CacheConfig(cached),
        sample_miss_detection=MissDetectionConfig(heartbeat=beat_s, sporadic_heartbeat=None),
        publisher_detection=True,
    )
