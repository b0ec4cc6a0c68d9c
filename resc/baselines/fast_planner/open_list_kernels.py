"""The open list of the search: compiled for `search_kernels`.

A binary heap of nodes, the cheapest on top; `costs` are theirs, of which the second counts. Nodes
may be in a wrong place after their cost has fallen, as with the released planner, and many cost the
same; so the heap moves its elements as that of the C++ library does. The kernels are marked
`no_type_check`: numba cannot compile the wrappers of the tests' type checker.
"""

from typing import no_type_check

from numba import njit


@njit(cache=True, nogil=True, error_model="numpy")
@no_type_check
def rise(heap, place, top, node, costs):
    """Puts a node into a free place of the heap, or above as long as its parents cost more."""
    while place > top:
        above = (place - 1) // 2
        if not costs[heap[above], 1] > costs[node, 1]:
            break
        heap[place] = heap[above]
        place = above
    heap[place] = node


@njit(cache=True, nogil=True, error_model="numpy")
@no_type_check
def _sink(heap, size, place, node, costs):
    """Takes the free place down to a leaf, along the cheaper children, and lets a node rise."""
    top, child = place, place
    while child < (size - 1) // 2:
        child = 2 * child + 2
        if costs[heap[child], 1] > costs[heap[child - 1], 1]:
            child -= 1
        heap[place] = heap[child]
        place = child
    if size % 2 == 0 and child == (size - 2) // 2:
        child = 2 * child + 1
        heap[place] = heap[child]
        place = child
    rise(heap, place, top, node, costs)


@njit(cache=True, nogil=True, error_model="numpy")
@no_type_check
def pop(heap, size, costs):
    """The first node; the heap is one shorter afterwards."""
    first = heap[0]
    if size > 1:
        _sink(heap, size - 1, 0, heap[size - 1], costs)
    return first


@njit(cache=True, nogil=True, error_model="numpy")
@no_type_check
def lift(heap, size, node, costs):
    """Puts a node whose cost has changed where it belongs."""
    for place in range(size):
        if heap[place] == node:
            rise(heap, place, 0, node, costs)
            return
