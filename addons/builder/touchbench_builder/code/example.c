/* An example in C: replace read_frame with your sensor. make example, then ./example. */

#include <stdio.h>

#include "touch.h"

/* The next frame of the sensor, row by row, readings from 0 to TOUCH_FULL_SCALE; 0 if there is none. Here: a ramp. */
static int read_frame(float *frame)
{
    static int n;
    for (int i = 0; i < TOUCH_TAXELS; i++)
        frame[i] = TOUCH_FULL_SCALE * (float)((n + i) % 16) / 16;
    return n++ < (int)(2 * TOUCH_RATE_HZ);
}

int main(void)
{
    static float frame[TOUCH_TAXELS];
#if TOUCH_WATCH
    static touch_watch_t watch;
    touch_event_t event;
    touch_watch_init(&watch);
    while (read_frame(frame)) { /* TOUCH_RATE_HZ times a second, for ever */
        int news = touch_watch(&watch, frame, &event);
        if (news == TOUCH_REPORTED || news == TOUCH_CHANGED)
            printf("%s\n", event.label == TOUCH_UNKNOWN ? "unknown" : touch_name(event.label));
    }
#else
    static touch_t touch;
    float probabilities[TOUCH_CLASSES];
    touch_init(&touch); /* when a touch begins */
    while (read_frame(frame))
        touch_push(&touch, frame);
    int label = touch_label(&touch, probabilities, 0); /* when it ends, or earlier */
    printf("%s\n", touch_name(label));
#endif
    return 0;
}
