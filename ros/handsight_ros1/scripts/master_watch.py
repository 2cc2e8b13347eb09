"""Registers a node again with a master that was restarted: such a master knows nobody, and rospy does not notice."""

import xmlrpc.client

import rosgraph
import rospy


class MasterWatch:
    """Registers what this node publishes, subscribes to and serves with a master that does not know it yet."""

    def __init__(self, services):
        """`services`: the services of this node."""
        self._services = services
        self._name, self._uri = rospy.get_name(), rospy.core.get_node_uri()
        self._pid = rosgraph.Master(self._name).getPid()

    def look(self):
        """Returns whether the master was another one than before; to be called about once a second."""
        master = rosgraph.Master(self._name)
        try:
            pid = master.getPid()
        except (OSError, rosgraph.MasterException):
            return False  # it is gone; what is connected stays connected
        known, self._pid = self._pid == pid, pid
        if known:
            return False
        try:
            self._register(master)
        except (OSError, rosgraph.MasterException, xmlrpc.client.Error):
            self._pid = -1  # it is gone again: the next one is another
            return False
        return True

    def _register(self, master):
        with xmlrpc.client.ServerProxy(self._uri) as own:
            for topic, kind in own.getPublications(self._name)[2]:
                master.registerPublisher(topic, kind, self._uri)
            for topic, kind in own.getSubscriptions(self._name)[2]:
                publishers = master.registerSubscriber(topic, kind, self._uri)
                own.publisherUpdate("/master", topic, publishers)
        for service in self._services:
            master.registerService(service.resolved_name, service.uri, self._uri)
