#include "touch.c"
static touch_t t;
int state_bytes(void) { return sizeof t; }
int library(const float *frames, int n, int every, float *proba, float *settled, float *features, int *ready)
{
    int label = touch_init(&t);
    for (int i = 0; i < n && label >= 0; i++) {
        label = ready[i] = touch_push(&t, frames + (long)i * TAXELS);
        if (label >= 0 && (every || i == n - 1))
            label = touch_label(&t, proba + (long)i * CLASSES, settled);
    }
    memcpy(features, t.features, sizeof t.features);
    return label;
}
