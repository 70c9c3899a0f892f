/* The functions for captures, and when to decide. */

int touch_init(touch_t *t)
{
    if (!t)
        return TOUCH_BAD;
    memset(t, 0, sizeof *t);
    return 0;
}

#if CALIBRATED
static float milliseconds(int frames) { return 1000.0f / RATE_HZ * (float)frames; }

/* Probabilities as sure as training people have shown them to be after so many frames, in place. */
static void calibrated(float *proba, int frames)
{
    float place = 0;
    if (LAST_MS > FIRST_MS)
        place = logf(milliseconds(frames) / FIRST_MS) / logf(LAST_MS / FIRST_MS);
    place = fminf(fmaxf(place, 0), 1);
    float heat = expf(logf(FIRST_HEAT) * (1 - place) + logf(LAST_HEAT) * place);
    for (int c = 0; c < CLASSES; c++)
        proba[c] = logf(fmaxf(proba[c], 1e-6f)) / heat;
    softmax(proba, CLASSES);
}
#endif

#if STOPPING
/* One less what waiting is expected to gain: probabilities before calibration, and the label before, or -1. */
static float settled_of(const float *proba, int frames, int label, int before)
{
    static const float weights[11] = WAITING;
    float top[3] = {0, 0, 0};
    for (int c = 0; c < CLASSES; c++)
        for (int k = 0; k < 3; k++)
            if (proba[c] > top[k]) {
                for (int l = 2; l > k; l--)
                    top[l] = top[l - 1];
                top[k] = proba[c];
                break;
            }
    float late = logf(milliseconds(frames) / 62.5f), same = before == label;
    const float state[11] = {1, top[0], top[0] * top[0], top[1], top[2], late, late * late, top[0] * late, top[1] * late,
                             same, same * late};
    float gain = 0;
    for (int k = 0; k < 11; k++)
        gain += weights[k] * state[k];
    return fminf(fmaxf(1 - gain, 0), 1);
}

/* The label that stood when 1/1.41 as much had been seen, -1 if there was none; this one is remembered. */
static int earlier(touch_t *t, int label)
{
    int drop = 0;
    while (drop + 1 < t->remembered && (float)t->label_at[drop + 1] * 1.41421356f <= (float)t->seen)
        drop++;
    for (int i = drop; i < t->remembered; i++) {
        t->label_at[i - drop] = t->label_at[i];
        t->labels[i - drop] = t->labels[i];
    }
    t->remembered -= drop;
    int found = t->remembered && (float)t->label_at[0] * 1.41421356f <= (float)t->seen ? t->labels[0] : -1;
    if (t->remembered == REMEMBERED) { /* every second one will do */
        t->remembered = REMEMBERED / 2;
        for (int i = 0; i < t->remembered; i++) {
            t->label_at[i] = t->label_at[2 * i];
            t->labels[i] = t->labels[2 * i];
        }
    }
    t->label_at[t->remembered] = t->seen;
    t->labels[t->remembered++] = (int16_t)label;
    return found;
}
#endif

#if defined(__FINITE_MATH_ONLY__) && __FINITE_MATH_ONLY__
#error "build touch.c without -ffast-math (-Ofast, -ffinite-math-only): it would take NaN for a reading"
#endif

/* Whether readings lie within 0, or little below, and the full scale. */
static int is_frame(const float *frame)
{
    for (int i = 0; i < TAXELS; i++)
        if (!(frame[i] >= -NEGATIVE && frame[i] <= FULL_SCALE)) /* not a number is neither */
            return 0;
    return 1;
}

int touch_push(touch_t *t, const float *frame)
{
    if (!t || !frame || !is_frame(frame))
        return TOUCH_BAD;
    if (t->seen >= LONGEST)
        return TOUCH_LONG;
#if WINDOW && !CONVOLVED
    take(t, frame);
#else
    for (int i = 0; i < TAXELS; i++)
        t->frame[i] = fmaxf(frame[i], 0);
    prepared(t, t->frame);
#endif
#if CONVOLVED
    int ready = join(t, t->frame);
    if (ready) {
        decide(t, t->proba);
        for (int c = 0; c < CLASSES; c++)
            t->sum[c] += t->proba[c];
        t->windows++;
    }
    return ready;
#elif WINDOW
    int at = t->seen++;
    int ready = halves(t->parts, t->frame, at, WINDOW, HOP);
    if (ready) {
        features_of_halves(t, WINDOW, t->parts);
        decide(t, t->proba);
        for (int c = 0; c < CLASSES; c++)
            t->sum[c] += t->proba[c];
        t->windows++;
    }
#if EARLY
    if (at < WINDOW && halves(t->parts + 2, t->frame, at, EARLY, EARLY_HOP) && !ready) {
        ready = 1;
        features_of_halves(t, EARLY, t->parts + 2);
        decide_early(t, t->proba);
        for (int c = 0; c < CLASSES; c++)
            t->early_sum[c] += t->proba[c];
        t->early_windows++;
    }
#endif
    for (int i = 0; i < TAXELS; i++)
        t->before[i] = t->frame[i];
    return ready;
#else
    join(t, t->frame, t->before);
    t->seen++;
    for (int i = 0; i < TAXELS; i++)
        t->before[i] = t->frame[i];
    return 1;
#endif
}

/* Probabilities of what has been seen, before calibration. */
static void label_so_far(touch_t *t, float *proba)
{
#if CONVOLVED
    int windows = t->windows;
    for (int c = 0; c < CLASSES; c++)
        t->proba[c] = 0;
    if (!windows || t->seen > (windows - 1) * HOP + WINDOW) { /* frames that no window has ended with */
        features_until_now(t);
        decide(t, t->proba);
        windows++;
    }
    for (int c = 0; c < CLASSES; c++)
        proba[c] = (t->sum[c] + t->proba[c]) / (float)windows;
#elif WINDOW
    if (t->windows) {
        for (int c = 0; c < CLASSES; c++)
            proba[c] = t->sum[c] / (float)t->windows;
        return;
    }
#if EARLY
    if (t->early_windows) {
        for (int c = 0; c < CLASSES; c++)
            proba[c] = t->early_sum[c] / (float)t->early_windows;
        return;
    }
    features_of_halves(t, t->seen, t->parts + 2);
    decide_early(t, proba);
#else
    features_of_halves(t, t->seen, t->parts);
    decide(t, proba);
#endif
#else
    features_of(t);
    decide(t, proba);
#endif
}

int touch_label(touch_t *t, float *probabilities, float *settled)
{
    if (!t || !probabilities)
        return TOUCH_BAD;
    if (!t->seen)
        return TOUCH_EMPTY;
    label_so_far(t, probabilities);
    int label = 0;
    for (int c = 1; c < CLASSES; c++)
        if (probabilities[c] > probabilities[label])
            label = c;
#if STOPPING
    int before = earlier(t, label);
    if (settled)
        *settled = settled_of(probabilities, t->seen, label, before);
#else
    if (settled)
        *settled = 0;
#endif
#if CALIBRATED
    calibrated(probabilities, t->seen);
#endif
    return label;
}

const char *touch_name(int label)
{
    static const char *const names[CLASSES] = NAMES;
    return label >= 0 && label < CLASSES ? names[label] : "";
}
