/* An example in C: replace read_frame with your sensor. make example, then ./example. */

#include <stdio.h>

#include "touch.h"

/* The next frame of the sensor, row by row, readings from 0 to TOUCH_FULL_SCALE; 0 if there is none. Here: a ramp.
   lost counts the frames that were lost before it, as your timer or the sensor's own counter tells. */
static int read_frame(float *frame, uint32_t *lost)
{
    static int n;
    for (int i = 0; i < TOUCH_TAXELS; i++)
        frame[i] = TOUCH_FULL_SCALE * (float)((n + i) % 16) / 16;
    *lost = 0;
    return n++ < (int)(2 * TOUCH_RATE_HZ);
}

#if TOUCH_WATCH
static void tell(int news, const touch_event_t *event)
{
    if (news == TOUCH_REPORTED || news == TOUCH_CHANGED)
        printf("%s\n", event->label == TOUCH_UNKNOWN ? "unknown" : touch_name(event->label));
}

/* What to do for each reason not to trust the watch. */
static const char *const advice[TOUCH_REASONS] = {
    "read the frame again; if it happens often, check bus and conversion",         /* not a number */
    "correct baseline and scale: readings are 0 to TOUCH_FULL_SCALE",              /* out of range */
    "lower the gain; do not trust labels of firm touches",                         /* saturated */
    "look for motors and bad contacts; do not act on touches while it lasts",      /* noise */
    "replace the skin soon; touches on these taxels are missed or named wrongly",  /* stuck */
    "call touch_watch once per new frame, at TOUCH_RATE_HZ; tell of lost frames",  /* rate */
    "calibrate without touch; do not act on touches while it lasts",               /* offset */
    "check supply and connector: the sensor may be off or its gain low",           /* gain */
    "compare the order of taxels with training; do not act on touches until then", /* unlike */
};

/* Tell of reasons that are new, and when all are gone. */
static void heed(int status)
{
    static int before;
    for (int bit = 0; bit < TOUCH_REASONS; bit++)
        if (status & ~before & 1 << bit)
            fprintf(stderr, "%s: %s\n", touch_reason(bit), advice[bit]);
    if (before && !status)
        fprintf(stderr, "the sensor is as in training again\n");
    before = status;
}
#endif

int main(void)
{
    static float frame[TOUCH_TAXELS];
    uint32_t lost;
#if TOUCH_WATCH
    static touch_watch_t watch;
    touch_event_t event;
    touch_watch_init(&watch);
    /* touch_set_confidence(&watch, 0.7f) makes less sure labels unknown: the certificate, whose promises are without it,
       tells how often the others are right. */
    while (read_frame(frame, &lost)) { /* TOUCH_RATE_HZ times a second, for ever */
        if (lost)
            tell(touch_missed(&watch, lost, &event), &event);
        int news = touch_watch(&watch, frame, &event);
        if (news == TOUCH_BAD) /* the frame was refused: it counts as lost, unless you read it again */
            news = touch_missed(&watch, 1, &event);
        tell(news, &event);
        heed(touch_status(&watch, 0));
    }
#else
    static touch_t touch;
    float probabilities[TOUCH_CLASSES];
    touch_init(&touch); /* when a touch begins */
    while (read_frame(frame, &lost)) {
        int code = touch_push(&touch, frame);
        if (code == TOUCH_BAD)
            fprintf(stderr, "a frame was refused\n");
        if (code == TOUCH_LONG) /* no touch in training lasted as long */
            break;
    }
    int label = touch_label(&touch, probabilities, 0); /* when it ends, or earlier */
    printf("%s\n", label < 0 ? "no touch" : touch_name(label));
#endif
    return 0;
}
