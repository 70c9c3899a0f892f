/* touch_watch as a library: a recording in; its news, each with its event, out. */

#include "touch.c"

#include <stdlib.h>

typedef struct {
    touch_event_t event;
    int news;
} news_t;

/* The number of news, which is n at most, or the code of a frame that was refused. */
int watch_recording(const float *frames, int n, news_t *news)
{
    touch_watch_t *w = malloc(sizeof *w);
    if (!w)
        return TOUCH_BAD;
    int count = 0, code = touch_watch_init(w);
    for (int i = 0; i < n && code >= 0; i++) {
        code = touch_watch(w, frames + (long)i * TAXELS, &news[count].event);
        news[count].news = code;
        count += code > 0;
    }
    free(w);
    return code < 0 ? code : count;
}
