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
#endif

/* The last tick joins the part. */
static void join_last(touch_t *t)
{
#if TICK > 1
    join_tick(&t->parts[0], &t->parts[1]);
#else
    join(&t->parts[0], t->frame);
#endif
}

/* Probabilities of the gestures from the part, which ended so many frames ago; they count by its ticks. */
static void name_part(touch_watch_t *w, int frames, float *proba)
{
    const touch_part_t *part = w->now.parts;
    w->now.seen -= frames;
    features_of(&w->now, part->n, &part, 1);
    w->now.seen += frames;
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

static void name_now(touch_watch_t *w)
{
    name_part(w, 0, w->now.proba);
    join_names(w, w->now.proba, w->length);
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
    return *confidence > 0 && *confidence >= REJECT ? class_of[best] : TOUCH_UNKNOWN;
}

/* A tick in which a touch is reported, renamed or over. */
static int news(touch_watch_t *w, sign_t sign, touch_event_t *event)
{
    touch_t *t = &w->now;
    int over = sign.report || sign.since <= 1, kind = 0, ends = 0; /* at 1, another touch begins */
    if (w->is_reported && (over || !sign.sure) && w->sure > w->named && w->after != w->sure) {
        name_part(w, TICK, w->last); /* the tick before is the last one that is surely touch */
        w->after = w->sure;
    }
    if (w->is_reported && over) {
        event->label = label_of(w, 1, &event->confidence);
        event->reported = w->reported;
        event->end = w->end;
        w->is_reported = 0;
        ends = 1;
    }
    join_last(t);
    w->length++;
    if (sign.sure)
        w->sure = w->length;
    if (sign.report) {
        w->is_reported = 1;
        w->reported = w->seen;
        w->first = w->length;
        w->weight = 0;
        memset(w->sum, 0, sizeof w->sum);
        kind = TOUCH_REPORTED;
    }
    if (w->is_reported) {
        w->end = w->seen;
        if (sign.report || (sign.sure && (float)w->length >= w->due)) {
            name_now(w);
            w->after = 0;
        }
        if (w->length >= PART_TICKS) { /* what follows is another part */
            if (w->sure == w->length && w->sure > w->named)
                name_now(w);
            else if (w->sure > w->named)
                join_names(w, w->last, w->after);
            forget(t->parts);
            w->length = w->named = w->sure = w->after = 0;
            w->due = (float)w->first;
        }
    }
    if (!sign.lasts) { /* a touch may begin with the next tick, whose name has the frames of this one, too */
        forget(t->parts);
        join_last(t);
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

static int watched(touch_watch_t *w, const float *frame, touch_event_t *event)
{
    touch_t *t = &w->now;
    sign_t sign = {0, 0, 0, 0};
    read_frame(t, frame);
#if TICK > 1
    for (int i = 0; i < TAXELS; i++)
        w->tick[i] = w->within ? w->tick[i] + t->frame[i] : t->frame[i];
    if (!w->within)
        forget(&t->parts[1]);
#endif
    int whole = ++w->within == TICK;
    if (whole) {
#if TICK > 1
        for (int i = 0; i < TAXELS; i++)
            w->tick[i] /= TICK;
        sign = sensed(w, w->tick);
#else
        sign = sensed(w, t->frame);
#endif
        w->within = 0;
        w->counts.refused += w->is_refused ? TICK : 0;
    }
    join_signals(t);
#if TICK > 1
    join(&t->parts[1], t->frame);
#endif
    memcpy(t->before, t->frame, sizeof t->frame);
    if (++t->seen == 2 * TURN) /* for ever: at the same place of the ring, and long enough for the repair */
        t->seen = TURN;
    return whole ? news(w, sign, event) : 0;
}
