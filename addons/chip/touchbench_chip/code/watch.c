/* An endless stream: what all detectors have in common. */

int touch_watch_init(touch_watch_t *w)
{
    if (!w)
        return TOUCH_BAD;
    memset(w, 0, sizeof *w);
    w->level = LEVEL;
    w->reject = REJECT;
    return 0;
}

int touch_set_threshold(touch_watch_t *w, int point)
{
    if (!w || point < 0 || point >= TOUCH_POINTS)
        return TOUCH_BAD;
    w->level = levels[point];
    return 0;
}

int touch_set_confidence(touch_watch_t *w, float least)
{
    if (!w || !(least >= 0 && least <= 1))
        return TOUCH_BAD;
    w->reject = least;
    return 0;
}

/* All reasons now, which are counted once for each frame. */
static void count_reasons(touch_watch_t *w)
{
    const touch_health_t *h = &w->health;
    w->status = w->of_frame | h->quiet_status | h->calm_status | h->touch_status | (w->is_refused ? TOUCH_NOISE : 0u);
    for (int k = 0; k < TOUCH_REASONS; k++)
        w->counts.reasons[k] += w->status >> k & 1;
}

/* What is wrong with a frame by itself, refused or saturated; negative readings are counted. */
static unsigned check_frame(touch_watch_t *w, const float *frame)
{
    int full = 0, negative = 0;
    for (int i = 0; i < TAXELS; i++) {
        if (isnan(frame[i]))
            return TOUCH_NOT_A_NUMBER;
        full += frame[i] >= FULL_SCALE;
        negative |= frame[i] < 0;
    }
    if (!is_frame(frame))
        return TOUCH_OUT_OF_RANGE;
    w->counts.clamped += (uint32_t)negative;
    return full >= SATURATED ? TOUCH_SATURATED : 0;
}

/* A frame that follows the last one, or repeats it in place of a lost one. */
static int advance(touch_watch_t *w, const float *frame, touch_event_t *event)
{
    w->seen++;
    int news = watched(w, frame, event);
    if (!w->within)
        finish_tick(&w->health);
    return news;
}

int touch_watch(touch_watch_t *w, const float *frame, touch_event_t *event)
{
    if (!w || !frame || !event)
        return TOUCH_BAD;
    w->of_frame = check_frame(w, frame);
    if (w->of_frame & (TOUCH_NOT_A_NUMBER | TOUCH_OUT_OF_RANGE)) {
        count_reasons(w);
        return TOUCH_BAD;
    }
    w->counts.frames++;
    examine_frame(&w->health, frame);
    int news = advance(w, frame, event);
    count_reasons(w);
    return news;
}

int touch_missed(touch_watch_t *w, uint32_t frames, touch_event_t *event)
{
    if (!w || !event)
        return TOUCH_BAD;
    w->counts.missed += frames;
    int kind = 0;
    if (frames <= MOST_LOST && w->now.seen) {
        touch_event_t next;
        for (uint32_t i = 0; i < frames; i++) {
            int news = advance(w, w->health.last, &next);
            if (!news)
                continue;
            kind = kind == TOUCH_REPORTED && news == TOUCH_CHANGED ? kind : news;
            *event = next;
        }
    } else {
        if (w->is_reported) {
            event->label = label_of(w, 1, &event->confidence);
            event->reported = w->reported;
            event->end = w->end;
            kind = TOUCH_ENDED;
        }
        memset(&w->now, 0, sizeof *w - offsetof(touch_watch_t, now)); /* the stream begins anew */
        w->seen += frames;
        w->health.is_lasting = w->health.tick_frames = w->health.pace_frames = 0;
        memset(w->health.tick, 0, sizeof w->health.tick);
    }
    w->health.follows = w->health.follows && !frames;
    return kind;
}

int touch_status(const touch_watch_t *w, touch_counts_t *counts)
{
    if (!w)
        return TOUCH_BAD;
    if (counts)
        *counts = w->counts;
    return (int)w->status;
}

const char *touch_reason(int bit)
{
    static const char *const words[TOUCH_REASONS] = {"not a number", "out of range", "saturated", "noise", "stuck",
                                                     "rate",         "offset",       "gain",      "unlike"};
    return bit >= 0 && bit < TOUCH_REASONS ? words[bit] : "";
}
