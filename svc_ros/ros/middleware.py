"""Transports that big clouds arrive by, and what to tell others to set. Fast DDS's own defaults lose them.

By default a process of the same machine is sent to through shared memory of the sender, 512 KiB: of a cloud of 1.4 MB
the beginning is overwritten before the reader has seen it. Who receives cannot change that, but can be reached by UDP
alone (or TCP), into socket buffers of its own. See docs/middleware.md.
"""

from __future__ import annotations

import contextlib
import os
import tempfile
from collections.abc import Iterator, Mapping
from pathlib import Path

from svc_ros.io.config_yaml import config_folder

PROFILE_VARIABLE = "FASTRTPS_DEFAULT_PROFILES_FILE"
PROFILE_NAME = "fastdds_large_clouds.xml"
SOCKET_BUFFER = 4 * 1024 * 1024  # bytes, as in the profile
_MOST_OF_USE = 32 * 1024 * 1024  # bytes; of what the kernel allows
_CHOICES = (PROFILE_VARIABLE, "FASTDDS_DEFAULT_PROFILES_FILE", "FASTDDS_BUILTIN_TRANSPORTS")
_OWN_FILE = "DEFAULT_FASTRTPS_PROFILES.xml"  # Fast DDS reads it in the working directory
_DEFAULT_RMW = "rmw_fastrtps_cpp"  # of Jazzy
_LARGEST_BUFFER = Path("/proc/sys/net/core/rmem_max")
# No shared memory, so that nobody sends through a segment that is too small.
_RECEIVER = """<?xml version="1.0" encoding="UTF-8"?>
<profiles xmlns="http://www.eprosima.com/XMLSchemas/fastRTPS_Profiles">
  <transport_descriptors>
    <transport_descriptor>
      <transport_id>udp</transport_id><type>UDPv4</type><receiveBufferSize>{buffer}</receiveBufferSize>
    </transport_descriptor>
    <transport_descriptor>
      <transport_id>tcp</transport_id><type>TCPv4</type><listening_ports><port>0</port></listening_ports>
      <calculate_crc>false</calculate_crc><check_crc>false</check_crc>
    </transport_descriptor>
  </transport_descriptors>
  <participant profile_name="receiver" is_default_profile="true">
    <rtps>
      {transports}
      <useBuiltinTransports>false</useBuiltinTransports>
    </rtps>
  </participant>
</profiles>
"""
# TCP for drivers with LARGE_DATA, which send clouds by nothing else to who has no shared memory.
_EVERYWHERE = "<userTransports><transport_id>udp</transport_id><transport_id>tcp</transport_id></userTransports>"
# Where discovery stays on the machine, ROS adds transports of its own, also to drivers. Their shared memory is not told
# of, so it stays out of use.
_ON_THIS_MACHINE = """<defaultUnicastLocatorList><locator><udpv4/></locator></defaultUnicastLocatorList>
      <userTransports><transport_id>udp</transport_id></userTransports>"""


def profile_path() -> Path:
    """Where config/fastdds_large_clouds.xml lies: in the checkout, or where the package was installed."""
    return config_folder() / PROFILE_NAME


def is_set_by_user(environment: Mapping[str, str] = os.environ) -> bool:
    """True if somebody has chosen transports for Fast DDS already: they are left alone then."""
    has_file = Path(_OWN_FILE).is_file() and environment.get("SKIP_DEFAULT_XML_FILE") != "1"
    return has_file or any(environment.get(name) for name in _CHOICES)


def profile_environment(environment: Mapping[str, str] = os.environ) -> dict[str, str]:
    """What is to be added to the environment of programs that send clouds, and of who listens to those.

    The shipped profile; nothing where the user has chosen.
    """
    is_wanted = profile_path().is_file() and not is_set_by_user(environment)
    return {PROFILE_VARIABLE: str(profile_path())} if is_wanted else {}


@contextlib.contextmanager
def receiving_transports() -> Iterator[bool]:
    """While this lasts, the first node of the process is made so that big clouds reach it, whoever sends them.

    Yields False, and changes nothing, where the user has chosen transports, or no file can be
    written. The middleware reads its profile when the
    first node of a process is made, and never again.
    """
    if is_set_by_user():
        yield False
        return
    buffer = min(max(largest_socket_buffer() or 0, SOCKET_BUFFER), _MOST_OF_USE)
    text = _RECEIVER.format(buffer=buffer, transports=_ON_THIS_MACHINE if _is_local(os.environ) else _EVERYWHERE)
    with contextlib.ExitStack() as stack:
        try:
            path = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="svc_ros_")), PROFILE_NAME)
            path.write_text(text, encoding="utf-8")
        except OSError:  # nothing can be written here: the middleware's defaults have to do
            yield False
            return
        os.environ[PROFILE_VARIABLE] = str(path)
        try:
            yield True
        finally:
            os.environ.pop(PROFILE_VARIABLE, None)


def _is_local(environment: Mapping[str, str]) -> bool:
    """True if discovery stays on this machine."""
    discovery = environment.get("ROS_AUTOMATIC_DISCOVERY_RANGE", "").upper()
    return discovery == "LOCALHOST" or environment.get("ROS_LOCALHOST_ONLY") == "1"


def largest_socket_buffer() -> int | None:
    """What the kernel lets a socket keep [bytes]; None where it does not say."""
    try:
        return int(_LARGEST_BUFFER.read_text())
    except (OSError, ValueError):
        return None


def cure() -> str:
    """What to do where clouds are lost, in one line."""
    steps = []
    largest, implementation = largest_socket_buffer(), os.environ.get("RMW_IMPLEMENTATION") or _DEFAULT_RMW
    if largest is not None and largest < SOCKET_BUFFER:
        steps.append(f"sudo sysctl -w net.core.rmem_max={SOCKET_BUFFER} (it is {largest})")
    if "fastrtps" in implementation:
        steps.append(f"export {PROFILE_VARIABLE}={profile_path()} in the driver's terminal and in this node's")
    return ", or ".join(steps) if steps else f"docs/middleware.md says what {implementation} needs"
