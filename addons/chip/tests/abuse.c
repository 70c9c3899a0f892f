#include "touch.c"
#include <stdio.h>
#include <stdlib.h>
static touch_t t, kept;
int main(void)
{
    static float frame[TAXELS], proba[CLASSES], settled;
    unsigned seed = 1;
    if (touch_init(0) != TOUCH_BAD || touch_push(0, frame) != TOUCH_BAD || touch_label(0, proba, 0) != TOUCH_BAD)
        return 1;
    touch_init(&t);
    if (touch_push(&t, 0) != TOUCH_BAD || touch_label(&t, 0, 0) != TOUCH_BAD)
        return 2;
    if (touch_label(&t, proba, 0) != TOUCH_EMPTY)
        return 2;
    const float odd[] = {NAN, INFINITY, -INFINITY, -NEGATIVE * 1.001f, FULL_SCALE * 1.001f, -FULL_SCALE};
    for (int n = 0; n < 3000; n++) {
        int bad = 0;
        for (int i = 0; i < TAXELS; i++) {
            seed = seed * 1103515245u + 12345u;
            frame[i] = seed % 3 ? (float)(seed >> 16 & 1023) : (n / 50 % 2 ? FULL_SCALE : 0);
        }
        if (n % 7 == 0) {
            frame[n % TAXELS] = odd[n % 6];
            bad = 1;
        }
        memcpy(&kept, &t, sizeof t);
        int code = touch_push(&t, frame);
        if (bad && (code != TOUCH_BAD || memcmp(&kept, &t, sizeof t)))
            return 3;
        if (!bad && code == TOUCH_LONG) {
            if (t.seen != LONGEST || memcmp(&kept, &t, sizeof t))
                return 4;
            touch_init(&t);
            continue;
        }
        if (!bad && code < 0)
            return 5;
        if (n % 11 == 5 && t.seen) {
            int label = touch_label(&t, proba, n % 2 ? &settled : 0);
            float sum = 0;
            if (label < 0 || label >= CLASSES || !touch_name(label)[0])
                return 6;
            for (int c = 0; c < CLASSES; c++) {
                if (!(proba[c] >= 0 && proba[c] <= proba[label]))
                    return 7;
                sum += proba[c];
            }
            if (!(fabsf(sum - 1) < 1e-3f))
                return 8;
        }
        if (n % 500 == 499)
            touch_init(&t);
    }
    return touch_name(-1)[0] || touch_name(CLASSES)[0];
}
