/* Touches of a stream tick by tick, and their names, from sums over the frames of a part of the touch. */

/* What the rules of a detector find in a tick: ticks since the touch began, 0 without; whether it lasts, is reported
   now, and is surely a touch. */
typedef struct {
    int since, lasts, report, sure;
} sign_t;

/* The sign of a tick, from its readings; works in w->now.taxels and w->now.features. */
static sign_t sensed(touch_watch_t *w, const float *tick);

#if TICK > 1
/* What the taxels did in a tick joins what they did before (Chan, Golub and LeVeque). */
static void join_tick(touch_part_t *part, const touch_part_t *tick)
{
#if STEPPED
    for (int i = 0; i < TAXELS; i++) {
        part->sum[i] = (touch_sum_t)(part->sum[i] + tick->sum[i]);
        part->squares[i] += tick->squares[i];
        part->most[i] = part->most[i] > tick->most[i] ? part->most[i] : tick->most[i];
    }
#else
    float n = (float)part->n, more = (float)tick->n, both = n + more;
    for (int i = 0; i < TAXELS; i++) {
        float away = tick->mean[i] - part->mean[i];
        part->m2[i] += tick->m2[i] + away * away * n * more / both;
        part->mean[i] += away * more / both;
        part->most[i] = fmaxf(part->most[i], tick->most[i]);
    }
#endif
    part->n += tick->n;
}

/* What the taxels do in this tick (back 0), or did in the last one (1), which a decision in slices still needs. */
static touch_part_t *tick_part(touch_watch_t *w, int back) { return w->now.parts + 1 + (SLICES > 1 && w->odd != back); }
#endif

/* The last tick joins the part. */
static void join_last(touch_watch_t *w)
{
#if TICK > 1
    join_tick(&w->now.parts[0], tick_part(w, 1));
#else
    join(&w->now.parts[0], w->now.frame);
#endif
}

enum { IDLE, TICKED, AT_END, GROWING };  /* stages of a decision: a name at the end of a touch, then one as it grows */
enum { NAME_STEPS = FEATURE_STEPS + 1 }; /* of a name: its features, and the classifier */

/* A step of the probabilities of the gestures from the part, which count by its ticks. */
static void go_on_naming(touch_watch_t *w, int step)
{
    const touch_part_t *part = w->now.parts;
    float *proba = w->stage == AT_END ? w->last : w->now.proba;
    int end = w->stage == AT_END ? w->until - TICK : w->until; /* without the last tick, which is not surely touch */
    if (step < FEATURE_STEPS) {
        feature_step(&w->now, end, part->n, &part, 1, step);
        return;
    }
    measure_pace(&w->health, w->now.features, part->n);
    name(&w->now, proba);
    for (int c = 0; c < NAMED; c++)
        proba[c] *= (float)w->length;
}

/* Probabilities join those of the touch. */
static void join_names(touch_watch_t *w, const float *proba, int ticks)
{
    for (int c = 0; c < NAMED; c++)
        w->sum[c] += proba[c];
    w->weight += (float)ticks;
    w->named = ticks;
    w->due = GROWTH * (float)ticks;
}

/* The label of the touch, and how sure it is, with the name at its end or without. */
static int label_of(touch_watch_t *w, int at_end, float *confidence)
{
    int best = 0, also = at_end && w->after;
    float sum[NAMED], weight = w->weight + (also ? (float)w->after : 0);
    for (int c = 0; c < NAMED; c++) {
        sum[c] = w->sum[c] + (also ? w->last[c] : 0);
        best = sum[c] > sum[best] ? c : best;
    }
    *confidence = sum[best] / weight;
    return *confidence > 0 && *confidence >= w->reject ? class_of[best] : TOUCH_UNKNOWN;
}

/* Whether the touch needs a name from the part before the last tick. */
static int needs_last_name(touch_watch_t *w)
{
    if (!w->is_reported || (!w->is_over && w->is_sure) || w->sure <= w->named || w->after == w->sure)
        return 0;
    w->after = w->sure;
    return 1;
}

/* The last tick joins the part; whether the touch needs a name from it. */
static int needs_next_name(touch_watch_t *w)
{
    join_last(w);
    w->length++;
    if (w->is_sure)
        w->sure = w->length;
    int lasts = w->is_reported && !w->is_over && w->is_sure;
    w->is_grown = w->is_new || (lasts && ((float)w->length >= w->due || w->length >= PART_TICKS));
    return w->is_grown;
}

/* A tick in which a touch is reported, renamed or over. */
static int news(touch_watch_t *w, touch_event_t *event)
{
    int kind = 0, ends = 0;
    if (w->is_reported && w->is_over) {
        event->label = label_of(w, 1, &event->confidence);
        event->reported = w->reported;
        event->end = w->end;
        w->is_reported = 0;
        ends = 1;
    }
    if (w->is_new) {
        w->is_reported = 1;
        w->reported = w->seen;
        w->first = w->length;
        w->weight = 0;
        memset(w->sum, 0, sizeof w->sum);
        kind = TOUCH_REPORTED;
    }
    if (w->is_reported) {
        w->end = w->seen;
        if (w->is_grown) {
            join_names(w, w->now.proba, w->length);
            w->after = 0;
        }
        if (w->length >= PART_TICKS) { /* what follows is another part */
            if (w->sure > w->named)
                join_names(w, w->last, w->after);
            forget(w->now.parts);
            w->length = w->named = w->sure = w->after = 0;
            w->due = (float)w->first;
        }
    }
    if (!w->is_lasting) { /* a touch may begin with the next tick, whose name has the frames of this one, too */
        forget(w->now.parts);
        join_last(w);
        w->length = 1;
        w->named = w->sure = w->after = 0;
    }
    if (ends)
        return TOUCH_ENDED;
    if (!w->is_reported)
        return 0;
    float confidence;
    int label = label_of(w, 0, &confidence);
    if (!kind && label != w->label)
        kind = TOUCH_CHANGED;
    w->label = label;
    if (kind) {
        event->label = label;
        event->confidence = confidence;
        event->reported = w->reported;
        event->end = 0;
    }
    return kind;
}

/* Decide on the last tick: go on with its names, until a share of their work is done, and tell the news with the last
   of SLICES slices. The first one, in the frame that ends the tick, has the work of the detector instead. */
static int decide_on_tick(touch_watch_t *w, int slice, touch_event_t *event)
{
    static const int costs[NAME_STEPS] = NAME_COSTS;
    int ends = slice == SLICES - 1;
    while (w->stage != IDLE) {
        if (w->step < NAME_STEPS) {
            if (!ends && (2 * w->spent + costs[w->step]) * (SLICES - 1) > 2 * NAME_COST * slice)
                return 0;
            w->spent += costs[w->step];
            go_on_naming(w, w->step++);
        } else if (w->stage == GROWING) {
            if (!ends)
                return 0;
            w->stage = IDLE;
            return news(w, event);
        } else {
            int needs = w->stage == TICKED ? needs_last_name(w) : needs_next_name(w);
            w->step = needs ? 0 : NAME_STEPS;
            w->stage++;
        }
    }
    return 0;
}

/* The last frame that was read, for a detector, which measures the noise: before its filter. */
static const float *sensed_frame(const touch_t *t)
{
#if REPAIR_NOISE
    return t->recent[t->newest];
#else
    return t->frame;
#endif
}

static int watched(touch_watch_t *w, const float *frame, touch_event_t *event)
{
    touch_t *t = &w->now;
    sign_t sign = {0, 0, 0, 0};
    read_frame(t, frame);
    const float *seen = sensed_frame(t);
#if TICK > 1
    for (int i = 0; i < TAXELS; i++)
        w->tick[i] = w->within ? w->tick[i] + seen[i] : seen[i];
    if (!w->within)
        forget(tick_part(w, 0));
#endif
    int whole = ++w->within == TICK;
    if (whole) {
#if TICK > 1
        for (int i = 0; i < TAXELS; i++)
            w->tick[i] /= TICK;
        sign = sensed(w, w->tick);
#else
        sign = sensed(w, seen);
#endif
        w->within = 0;
    }
    join_signals(t);
#if TICK > 1
    join(tick_part(w, 0), t->frame);
#endif
    memcpy(t->before, t->frame, sizeof t->frame);
    if (++t->seen == 2 * TURN) /* for ever: at the same place of the ring, and long enough for the repair */
        t->seen = TURN;
    if (whole) {
        w->is_over = sign.report || sign.since <= 1; /* at 1, another touch begins */
        w->is_new = w->health.is_new = sign.report;
        w->health.since = sign.since;
        w->is_sure = sign.sure;
        w->is_lasting = sign.lasts;
        w->odd = !w->odd;
        w->until = t->seen;
        w->stage = TICKED;
        w->step = NAME_STEPS;
        w->spent = 0;
    }
    return w->within < SLICES ? decide_on_tick(w, w->within, event) : 0;
}
