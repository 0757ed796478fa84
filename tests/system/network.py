"""Hosts of a network, as Linux namespaces: own interfaces, name, shared memory, cable.

Everything hangs on processes that end with the test, however it ends; nothing is left behind, and
no rights are needed where the kernel lets users have namespaces.
"""

from __future__ import annotations

import shutil
import subprocess
from collections.abc import Sequence

SUBNET = '10.77.0'
TOOLS = ('unshare', 'nsenter', 'ip', 'mount')
_HOLD = 'echo ready && exec cat'
"""Says that the namespaces are there and keeps them until standard input closes."""


class NetworkUnavailableError(Exception):
    """Why there can be no such network here."""


class Network:
    """A switch and the hosts on it.

    Args:
        hosts: their names.

    Raises:
        NetworkUnavailableError: a tool is missing, or the kernel does not let this user.
    """

    def __init__(self, hosts: Sequence[str]) -> None:
        missing = [tool for tool in TOOLS if shutil.which(tool) is None]
        if missing:
            raise NetworkUnavailableError(
                f'{", ".join(missing)} not found: install util-linux and iproute2'
            )
        self._holders: list[subprocess.Popen[str]] = []
        self._pids: dict[str, int] = {}
        self.addresses = {name: f'{SUBNET}.{k + 1}' for k, name in enumerate(hosts)}
        try:
            self._switch = self._hold(
                ['unshare', '--user', '--map-root-user', '--net', '--mount'], ''
            )
            self._at_switch('ip', 'link', 'add', 'switch', 'type', 'bridge')
            self._at_switch('ip', 'link', 'set', 'switch', 'up')
            for name in hosts:
                self._plug_in(name)
        except BaseException:
            self.close()
            raise

    def _hold(self, enter: list[str], prepare: str) -> int:
        """Start the process that namespaces live by; return its number."""
        command = [*enter, 'sh', '-c', prepare + _HOLD]
        holder = subprocess.Popen(
            command,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        self._holders.append(holder)
        assert holder.stdout is not None and holder.stderr is not None
        if holder.stdout.readline().strip() != 'ready':
            raise NetworkUnavailableError(f'{" ".join(enter)}: {holder.stderr.read().strip()}')
        return holder.pid

    def _plug_in(self, name: str) -> None:
        enter = [
            *self._entered(self._switch, '--net', '--mount'),
            'unshare',
            '--net',
            '--mount',
            '--uts',
            '--ipc',
        ]
        # Shared memory of its own: two hosts have none in common.
        pid = self._hold(
            enter, f'mount -t tmpfs tmpfs /dev/shm && echo {name} > /proc/sys/kernel/hostname && '
        )
        self._pids[name] = pid
        self._at_switch(
            'ip', 'link', 'add', name, 'type', 'veth', 'peer', 'name', 'eth0', 'netns', str(pid)
        )
        self._at_switch('ip', 'link', 'set', name, 'master', 'switch', 'up')
        for words in (
            ['link', 'set', 'lo', 'up'],
            ['addr', 'add', f'{self.addresses[name]}/24', 'dev', 'eth0'],
            ['link', 'set', 'eth0', 'up'],
        ):
            self._run(self.on(name, ['ip', *words]))

    @staticmethod
    def _entered(pid: int, *namespaces: str) -> list[str]:
        return ['nsenter', '--target', str(pid), '--user', '--preserve-credentials', *namespaces]

    def on(self, host: str, command: Sequence[str]) -> list[str]:
        """The command line that runs a command on a host, as one process that hears signals."""
        return [*self._entered(self._pids[host], '--net', '--mount', '--uts', '--ipc'), *command]

    def pull_plug(self, host: str) -> None:
        """Cut a host off: its carrier is gone, and others forget its address, as in time."""
        self._at_switch('ip', 'link', 'set', host, 'down')
        for other in self._pids.keys() - {host}:
            self._run(
                self.on(other, ['ip', 'neigh', 'flush', 'to', self.addresses[host], 'dev', 'eth0'])
            )

    def plug_in_again(self, host: str) -> None:
        """Let a host that was cut off back on the network."""
        self._at_switch('ip', 'link', 'set', host, 'up')

    def bytes_to(self, host: str) -> int:
        """Bytes that have gone to a host over its cable so far."""
        lines = self._run(self.on(host, ['cat', '/proc/net/dev'])).splitlines()
        return next(int(line.split(':')[1].split()[0]) for line in lines if 'eth0:' in line)

    def close(self) -> None:
        """Take everything down; processes on the hosts must have ended."""
        for holder in reversed(self._holders):
            holder.kill()
            holder.communicate()
        self._holders.clear()

    def _at_switch(self, *command: str) -> None:
        self._run([*self._entered(self._switch, '--net', '--mount'), *command])

    @staticmethod
    def _run(command: list[str]) -> str:
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        if done.returncode:
            raise NetworkUnavailableError(f'{" ".join(command)}: {done.stderr.strip()}')
        return done.stdout
