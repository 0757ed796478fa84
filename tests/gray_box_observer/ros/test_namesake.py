"""Another node of our name is told of as long as it lives."""

from types import SimpleNamespace

import pytest

from gray_box_observer.ros.namesake import EVERY_NODE_PUBLISHES, has_namesake

OWN = ('observer', '/left')
ELSEWHERE = ('observer', '/right')


class GraphOfNodes:
    """A node with what its middleware knows of others."""

    def __init__(self, listed: list[tuple[str, str]], publishing: list[tuple[str, str]]) -> None:
        self.get_name = lambda: OWN[0]
        self.get_namespace = lambda: OWN[1]
        self.get_node_names_and_namespaces = lambda: listed
        self._publishers = {
            EVERY_NODE_PUBLISHES: [
                SimpleNamespace(node_name=name, node_namespace=space) for name, space in publishing
            ]
        }

    def get_publishers_info_by_topic(self, topic: str) -> list[SimpleNamespace]:
        """Answer as the middleware does."""
        return self._publishers[topic]


@pytest.mark.parametrize(
    ('listed', 'publishing', 'expected'),
    [
        ([OWN], [OWN], False),
        ([OWN, ELSEWHERE], [OWN, ELSEWHERE], False),
        ([OWN, OWN], [OWN, OWN], True),
        ([OWN, OWN], [OWN, ELSEWHERE], False),  # one that has ended, and is still listed
    ],
)
def test_a_namesake_is_a_node_that_lives(listed, publishing, expected):
    assert has_namesake(GraphOfNodes(listed, publishing)) is expected
