/* The leaf of a tree that features end in: nodes in depth-first order, the left child follows, the right is told. */
static int leaf(const touch_node_t *nodes, int at, const float *x)
{
    while (nodes[at].feature >= 0)
        at = x[nodes[at].feature] < nodes[at].threshold ? at + 1 : at + nodes[at].right;
    return nodes[at].right;
}
