/* Compare the C with the predictions of Python for some captures (vectors.h); print differences. make test. */

#include <math.h>
#include <stdio.h>

#include "touch.h"
#include "vectors.h"

#define TOLERANCE 0.02f /* of probabilities: single precision, and trees at a threshold, may change them */

static touch_t touch;
static float frame[TOUCH_TAXELS], probabilities[TOUCH_CLASSES];

int main(void)
{
    const READING *next = readings;
    int wrong = 0;
    for (int v = 0; v < VECTORS; v++) {
        int label = touch_init(&touch);
        for (int n = 0; n < vectors[v].frames; n++) {
            for (int i = 0; i < TOUCH_TAXELS; i++)
                frame[i] = (float)*next++;
            if (label >= 0)
                label = touch_push(&touch, frame);
        }
        if (label >= 0)
            label = touch_label(&touch, probabilities, 0);
        int differs = label != vectors[v].label;
        for (int c = 0; c < TOUCH_CLASSES && !differs; c++)
            differs = !(fabsf(probabilities[c] - vectors[v].probabilities[c]) <= TOLERANCE);
        if (!differs)
            continue;
        wrong++;
        printf("capture %d: %s (%d) instead of %s (%d)\n", v + 1, touch_name(label), label, touch_name(vectors[v].label),
               vectors[v].label);
        for (int c = 0; c < TOUCH_CLASSES && label >= 0; c++)
            printf("  %s: %.4f instead of %.4f\n", touch_name(c), (double)probabilities[c],
                   (double)vectors[v].probabilities[c]);
    }
    printf("%d of %d captures as in Python\n", VECTORS - wrong, VECTORS);
    return wrong != 0;
}
