"""Bounds of rospy's connections: one that is silent keeps no other waiting, and a message has a largest size."""

import contextlib
import socket
import struct
import threading

import rospy
from rospy.exceptions import TransportTerminated
from rospy.impl.tcpros_base import TCPROSServer
from rospy.impl.tcpros_pubsub import TCPROSSub

HANDSHAKE_SECONDS = 5.0
"""How long a new connection may take to say what it wants."""
READ_AT_ONCE = 1 << 25, 1 << 16
"""Bytes that are read from a connection at once, of an image and of any other message."""
LARGEST = {READ_AT_ONCE[0]: 1 << 27, READ_AT_ONCE[1]: 1 << 24}
"""Bytes of the largest message, by those that are read at once; rospy would wait for 4 GiB, and keep what comes."""


def install():
    """Puts the bounds into rospy; call it before the node is initialised."""
    shake, read = TCPROSServer._tcp_server_callback, TCPROSSub.read_messages

    def shaken(server, sock, address):
        """Shakes hands in a thread of its own: rospy does so in the one that accepts all connections."""

        def end():
            with contextlib.suppress(OSError):
                sock.shutdown(socket.SHUT_RDWR)

        def wait():
            late = threading.Timer(HANDSHAKE_SECONDS, end)
            late.daemon = True
            late.start()
            shake(server, sock, address)
            late.cancel()

        threading.Thread(target=wait, daemon=True).start()

    def bounded(protocol, buffer, queue, sock):
        """Reads messages, unless the next one is announced to be larger than any of its type."""
        read(protocol, buffer, queue, sock)
        largest = LARGEST.get(protocol.buff_size, max(LARGEST.values()))
        if buffer.tell() >= 4 and struct.unpack("<I", buffer.getbuffer()[:4])[0] > largest:
            name = protocol.resolved_name
            rospy.logwarn("%s: expected messages of at most %d bytes: disconnected", name, largest)
            raise TransportTerminated(f"{name}: too large a message")

    TCPROSServer._tcp_server_callback, TCPROSSub.read_messages = shaken, bounded
