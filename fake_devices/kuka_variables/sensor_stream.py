"""The Robot Sensor Interface with ONLYSEND: XML datagrams, and no answer is wanted.

Imitates
    An ETHERNET object that sends DEF_RIst, DEF_AIPos and DEF_Delay every 4 ms.
Source
    Datagrams as RSIPI 0.3.0 and public KUKA set-ups keep them.
Modelled
    RIst (zeros: nothing here needs the pose), AIPos in degrees with four decimals, Delay, IPOC in milliseconds.
Not modelled
    Corrections; a cycle of 12 ms; ASPos and whatever else a configuration may name.
"""

from collections.abc import Sequence

_CYCLE_MS = 4
_FIRST_COUNT = 4_208_163_000


def encode_robot_datagram(count: int, real_s: float, joints_deg: Sequence[float]) -> bytes:
    """Return one ``<Rob>`` datagram; the controller's count of milliseconds goes on with the cycle."""
    del count
    turned = " ".join(f'A{axis}="{angle:.4f}"' for axis, angle in enumerate(joints_deg, 1))
    place = " ".join(f'{name}="0.0000"' for name in "XYZABC")
    ipoc = _FIRST_COUNT + round(real_s * 1000.0 / _CYCLE_MS) * _CYCLE_MS
    return (
        f'<Rob Type="KUKA"><RIst {place}/><AIPos {turned}/><Delay D="0"/><IPOC>{ipoc}</IPOC></Rob>'
    ).encode("ascii")
