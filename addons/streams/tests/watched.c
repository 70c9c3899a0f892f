#include "touch.c"
static touch_watch_t w;
typedef struct { touch_event_t event; int news; uint32_t seen; } news_t;
void start(void) { touch_watch_init(&w); }
int stream(const float *frames, int n, news_t *news)
{
    int count = 0;
    for (int i = 0; i < n; i++, count += news[count].news != 0) {
        news[count].news = touch_watch(&w, frames + (long)i * TAXELS, &news[count].event);
        news[count].seen = w.seen;
        if (news[count].news < 0)
            return -1;
    }
    return count;
}
int set(int point) { return touch_set_threshold(&w, point); }
int confidence(double least) { return touch_set_confidence(&w, (float)least); }
int status(touch_counts_t *counts) { return touch_status(&w, counts); }
float pace(void) { return w.health.slow_pace; } /* of touches, mean over blocks */
int missed(uint32_t n, news_t *news)
{
    news->news = touch_missed(&w, n, &news->event);
    news->seen = w.seen;
    return news->news;
}
/* The status after each frame; refused frames are taken, too. */
void statuses(const float *frames, int n, int *status)
{
    touch_event_t event;
    for (int i = 0; i < n; i++) {
        touch_watch(&w, frames + (long)i * TAXELS, &event);
        status[i] = touch_status(&w, 0);
    }
}
