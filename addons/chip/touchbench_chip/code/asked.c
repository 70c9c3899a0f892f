/* The program as a library: one capture in; its label, probabilities, and whether it looks unlike training out. */

#include "touch.c"

#include <stdlib.h>

int asked(const float *frames, int n, float *proba, int *unlike)
{
    touch_t *t = malloc(sizeof *t);
    if (!t)
        return TOUCH_BAD;
    int label = touch_init(t);
    touch_look_t look;
    touch_look_init(&look);
    for (int i = 0; i < n && label >= 0; i++) {
        label = touch_push(t, frames + (long)i * TAXELS);
        touch_look(&look, frames + (long)i * TAXELS);
    }
    *unlike = touch_unlike(&look);
    if (label >= 0 || label == TOUCH_LONG)
        label = touch_label(t, proba, 0);
    free(t);
    return label;
}
