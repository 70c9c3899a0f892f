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
int status(touch_counts_t *counts) { return touch_status(&w, counts); }
