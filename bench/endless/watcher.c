/* An endless stream: at every hop, is the sensor touched, does an event begin or end, and what is it called? */

/* Part k of the ring; the first ones lie where captures have their halves. */
static part_t *part_of(touch_watch_t *w, int k)
{
    return k < HELD ? &w->now.parts[k] : &w->parts[k - HELD];
}

/* Features of the last hops. */
static void features_of_hops(touch_watch_t *w, int hops)
{
    const part_t *parts[PARTS];
    for (int k = 0; k < hops; k++)
        parts[k] = part_of(w, (w->part + PARTS - hops + 1 + k) % PARTS);
    features_of(&w->now, hops * WATCH_HOP, parts, hops);
}

/* A frame joins the part of its hop; whether the hop ends with it. */
static int hopped(touch_watch_t *w, const float *frame)
{
    touch_t *t = &w->now;
    take(t, frame);
    int changed = !w->unchanged; /* the first one */
    for (int i = 0; i < TAXELS; i++)
        changed |= t->frame[i] != t->before[i];
    w->unchanged = changed ? 1 : w->unchanged < DETECT ? w->unchanged + 1 : DETECT;
    if (w->within == 0) {
        w->part = (w->part + 1) % PARTS;
        forget(part_of(w, w->part));
    }
    join(part_of(w, w->part), t->frame);
    memcpy(t->before, t->frame, sizeof t->frame);
    if (++t->seen == 2 * TURN) /* for ever: at the same place of the ring, and long enough for the repair */
        t->seen = TURN;
    if (++w->within < WATCH_HOP)
        return 0;
    w->within = 0;
    w->filled = w->filled < PARTS ? w->filled + 1 : PARTS;
    return w->filled >= DETECT / WATCH_HOP;
}

/* Logarithm of the sum of exponentials. */
static float log_sum(const float *scores, int n)
{
    float most = scores[0], sum = 0;
    for (int c = 1; c < n; c++)
        most = fmaxf(most, scores[c]);
    for (int c = 0; c < n; c++)
        sum += expf(scores[c] - most);
    return most + logf(sum);
}

/* Log-odds of touch of the detector's window; the first classes are no gesture. */
static float log_odds(touch_watch_t *w)
{
    float scores[DETECTED];
    int unusual = 0;
    w->is_refused = 1;
    if (w->unchanged == DETECT)
        return REFUSED;
    features_of_hops(w, DETECT / WATCH_HOP);
    detect(&w->now, scores);
    for (int i = 0; i < FEATURES; i++)
        unusual += !(fabsf(w->now.features[i]) <= UNUSUAL);
    if (unusual > MOST_UNUSUAL)
        return REFUSED;
    int likeliest = 0;
    for (int c = 1; c < DETECTED; c++)
        likeliest = scores[c] > scores[likeliest] ? c : likeliest;
    w->is_refused = likeliest >= SOUND && likeliest < QUIET; /* as a broken sensor */
    return log_sum(scores + QUIET, DETECTED - QUIET) - log_sum(scores, QUIET);
}

/* Probability that the sensor is touched now, from that at the hop before. */
static float filtered(float touched, float odds, float bias)
{
    float step = fminf(fmaxf(ODDS_WEIGHT * (odds + bias), -10), 10);
    float prior = touched * STAY + (1 - touched) * BEGIN;
    float both = prior / (1 - prior) * expf(step);
    return both / (1 + both);
}

/* Probabilities of the gestures in the recogniser's window, which wait until it is known that the touch went on. */
static void name(touch_watch_t *w)
{
    float *proba = w->now.proba, *kept = w->waiting[w->named % PENDING], sum = 0;
    features_of_hops(w, NAME / WATCH_HOP);
    decide(&w->now, proba);
    for (int c = 0; c < CLASSES; c++)
        sum += gesture[c] ? proba[c] : 0;
    for (int c = 0; c < CLASSES; c++)
        kept[c] = gesture[c] ? proba[c] / fmaxf(sum, 1e-9f) : 0;
    w->ends[w->named % PENDING] = w->seen;
    if (!w->named++)
        w->first = w->seen;
}

/* Windows that were complete after so many frames join the mean. */
static void join_until(touch_watch_t *w, uint32_t limit)
{
    for (; w->joined < w->named && (int32_t)(limit - w->ends[w->joined % PENDING]) >= 0; w->joined++)
        for (int c = 0; c < CLASSES; c++) {
            float mean = w->joined ? w->mean[c] : 0;
            w->mean[c] = mean + (w->waiting[w->joined % PENDING][c] - mean) / (float)(w->joined + 1);
        }
}

/* Whether the recogniser is wanted: a window lies in the touch, or a touch ends that is short but beyond doubt. */
static int wanted(const touch_watch_t *w)
{
    if (w->over)
        return 0;
    if (w->seen - w->crossed >= NAME)
        return 1;
    return w->falling && w->low == w->seen && w->filled == PARTS && !w->named && w->peak >= STRONG;
}

/* The rules of an event: reported, renamed or over. before: probability of touch at the hop before; odds: log-odds. */
static int news(touch_watch_t *w, float before, float odds, touch_event_t *event)
{
    float touched = w->touched;
    if (w->over) /* at the hop before */
        w->begun = w->falling = w->over = w->is_reported = w->named = w->joined = 0;
    if (touched > 0.5f && before <= 0.5f) {
        w->rise = w->seen;
        w->peak = odds;
    }
    w->peak = fmaxf(w->peak, odds);
    if (!w->begun) {
        if (touched > ON) {
            w->crossed = w->rise;
            w->begun = 1;
        }
    } else if (touched < OFF) {
        w->low = w->falling ? w->low : w->seen;
        w->falling = 1;
    } else if (touched > ON) {
        w->falling = 0;
    }
    if (!w->begun)
        return 0;
    w->over = w->falling && w->seen - w->low > HOLD;
    if (wanted(w))
        name(w);
    uint32_t limit = w->falling ? w->low : w->seen;
    if (w->is_reported) /* what comes before the end of a touch is seen with the end itself */
        limit = (int32_t)(limit - TAIL - w->limit) > 0 ? limit - TAIL : w->limit;
    w->limit = limit;
    join_until(w, limit);
    if (!w->joined || (!w->is_reported && !w->over && w->seen - w->first < WAIT))
        return 0;
    int best = -1, kind = 0;
    for (int c = 0; c < CLASSES; c++)
        if (gesture[c] && (best < 0 || w->mean[c] > w->mean[best]))
            best = c;
    int label = w->mean[best] >= REJECT ? best : TOUCH_UNKNOWN;
    if (!w->is_reported) {
        w->is_reported = kind = TOUCH_REPORTED;
        w->reported = w->seen;
    } else if (label != w->label) {
        kind = TOUCH_CHANGED;
    }
    w->label = label;
    kind = w->over ? TOUCH_ENDED : kind;
    if (kind) {
        event->label = label;
        event->confidence = w->mean[best];
        event->reported = w->reported;
        event->end = w->over ? w->low : 0;
    }
    return kind;
}

static int watched(touch_watch_t *w, const float *frame, touch_event_t *event)
{
    if (!hopped(w, frame))
        return 0;
    float before = w->touched, odds = log_odds(w);
    w->touched = filtered(before, odds, w->level);
    w->lasts = w->touched > 0.5f ? w->lasts + (w->lasts <= LASTING) : 0;
    w->is_refused |= w->lasts > LASTING; /* no touch lasts so long */
    w->counts.refused += w->is_refused ? WATCH_HOP : 0;
    return news(w, before, odds, event);
}
