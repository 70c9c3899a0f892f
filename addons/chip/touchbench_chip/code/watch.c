/* An endless stream: what all detectors have in common. */

int touch_watch_init(touch_watch_t *w)
{
    if (!w)
        return TOUCH_BAD;
    memset(w, 0, sizeof *w);
    w->level = LEVEL;
    return 0;
}

int touch_set_threshold(touch_watch_t *w, int point)
{
    if (!w || point < 0 || point >= TOUCH_POINTS)
        return TOUCH_BAD;
    w->level = levels[point];
    return 0;
}

/* Count a frame, and whether many of its taxels are at full scale. */
static void counted(touch_watch_t *w, const float *frame)
{
    int full = 0;
    for (int i = 0; i < TAXELS; i++)
        full += frame[i] >= FULL_SCALE;
    w->is_saturated = full >= SATURATED;
    w->counts.frames++;
    w->counts.saturated += (uint32_t)w->is_saturated;
    w->seen++;
}

int touch_watch(touch_watch_t *w, const float *frame, touch_event_t *event)
{
    if (!w || !frame || !event || !is_frame(frame))
        return TOUCH_BAD;
    counted(w, frame);
    return watched(w, frame, event);
}

int touch_status(const touch_watch_t *w, touch_counts_t *counts)
{
    if (!w)
        return TOUCH_BAD;
    if (counts)
        *counts = w->counts;
    return w->is_saturated ? TOUCH_SATURATED : w->is_refused ? TOUCH_REFUSED : TOUCH_OK;
}
