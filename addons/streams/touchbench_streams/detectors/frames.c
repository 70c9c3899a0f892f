/* Is a tick touch? Levels of the skin, how they compare with those of the last ticks, a classifier, and hysteresis. */

/* Puts the k-th smallest of n values in its place: none before it is larger, none behind it smaller (Hoare). */
static void place(float *x, int n, int k)
{
    for (int low = 0, high = n - 1; low < high;) {
        float pivot = x[low + (high - low) / 2];
        int i = low, j = high;
        while (i <= j) {
            while (x[i] < pivot)
                i++;
            while (x[j] > pivot)
                j--;
            if (i <= j) {
                float value = x[i];
                x[i++] = x[j];
                x[j--] = value;
            }
        }
        if (k <= j)
            high = j;
        else if (k >= i)
            low = i;
        else
            return;
    }
}

/* The mean of the highest taxels; leaves them in another order. */
static float mean_highest(float *x)
{
    int few = TAXELS / HIGHEST > 1 ? TAXELS / HIGHEST : 1;
    float sum = 0;
    place(x, TAXELS, TAXELS - few);
    for (int i = TAXELS - few; i < TAXELS; i++)
        sum += x[i];
    return sum / (float)few;
}

/* What all taxels share of a tick. */
static float shared(touch_watch_t *w, const float *tick)
{
    int k = (int)(COMMON * TAXELS);
    float *values = w->now.taxels;
    if (TAXELS == 1)
        return 0;
    memcpy(values, tick, sizeof w->now.taxels);
    place(values, TAXELS, k);
    return values[k];
}

static float cosine(float product, float a, float b)
{
    float length = sqrtf(a * b);
    return length > 0 ? product / length : 1;
}

/* How far some readings are above others: the differences, their mean and SD. */
static void compare(const float *now, const float *slow, float *values, float *mean, float *sd)
{
    float sum = 0, squares = 0;
    for (int i = 0; i < TAXELS; i++) {
        values[i] = now[i] - slow[i];
        sum += values[i];
    }
    *mean = sum / TAXELS;
    for (int i = 0; i < TAXELS; i++)
        squares += (values[i] - *mean) * (values[i] - *mean);
    *sd = sqrtf(squares / TAXELS);
}

/* Adds to each of the values in a line, a step apart, those on both sides. */
static void add_neighbours(float *x, int count, int step)
{
    float before = 0;
    for (int i = 0; i < count; i++, x += step) {
        float now = *x;
        *x = before + now + (i + 1 < count ? x[step] : 0);
        before = now;
    }
}

/* Signals from slow means, which follow the tick: of its readings above the slowest ones mean, how far the highest
   exceed it, SD; of the other means above the slowest one mean, highest and lowest mean of nine taxels, SD. */
static void follow(touch_watch_t *w, const float *tick, float *found)
{
    float *values = w->now.taxels, *slowest = w->slow[MEANS - 1];
    for (int k = 0; k < MEANS; k++)
        for (int i = 0; i < TAXELS; i++)
            w->slow[k][i] = w->looked ? w->slow[k][i] + look_paces[k] * (tick[i] - w->slow[k][i]) : tick[i];
    for (int k = MEANS - SLOW; k < MEANS; k++, found += 3) {
        compare(tick, w->slow[k], values, found, found + 2);
        found[1] = mean_highest(values) - found[0];
    }
    for (int k = 0; k < MEANS - 1; k++, found += 4) {
        compare(w->slow[k], slowest, values, found, found + 3);
        for (int r = 0; r < ROWS; r++)
            add_neighbours(values + r * COLS, COLS, 1);
        for (int c = 0; c < COLS; c++)
            add_neighbours(values + c, ROWS, COLS);
        found[1] = mean_highest(values) / 9;
        for (int i = 0; i < TAXELS; i++)
            values[i] = -values[i];
        found[2] = -mean_highest(values) / 9;
    }
}

/* Signals of a tick: its levels, area, likeness to the tick before, centroid, what all taxels share, and those from
   slow means. */
static void feel(touch_watch_t *w, const float *tick, float *found)
{
    float *values = w->now.taxels, least = shared(w, tick), size = ROWS > COLS ? ROWS : COLS;
    float mean = 0, total = 0, moved = 0, squares = 0, row = 0, col = 0, near = 0, near_squares = 0;
    follow(w, tick, found + LEVELS + 5);
    for (int i = 0; i < TAXELS; i++) {
        float flat = fmaxf(tick[i] - least, 0);
        if (!w->looked)
            w->baseline[i] = flat;
        float above = flat - w->baseline[i];
        w->baseline[i] += (above > 0 ? UP : DOWN) * above;
        above = fmaxf(above, 0);
        near += above * w->above[i];
        near_squares += w->above[i] * w->above[i];
        values[i] = fabsf(above - w->above[i]);
        w->above[i] = above;
        moved += values[i];
        mean += flat;
        total += above;
        squares += above * above;
        row += above * (float)(i / COLS);
        col += above * (float)(i % COLS);
    }
    found[0] = mean / TAXELS;
    found[1] = total / TAXELS;
    found[3] = moved / TAXELS;
    found[4] = mean_highest(values);
    memcpy(values, w->above, sizeof w->above);
    found[2] = mean_highest(values);
    found[LEVELS] = squares > 0 ? total * total / squares / TAXELS : 0;
    found[LEVELS + 1] = cosine(near, squares, near_squares);
    found[LEVELS + 2] = total > 0 ? row / total / size : 0;
    found[LEVELS + 3] = total > 0 ? col / total / size : 0;
    found[LEVELS + 4] = TAXELS > 1 ? least : tick[0];
}

/* Place in the rings of the tick so many ticks ago, or of the first one. */
static int back(const touch_watch_t *w, int ticks)
{
    int steps = ticks < w->looked ? ticks : w->looked - 1;
    return (w->at + LOOK - steps) % LOOK;
}

/* Logarithms of its levels, as the deciding classifier takes them. */
static const float *ago(const touch_watch_t *w, int ticks) { return w->logs[w->model][back(w, ticks)]; }

static float change(const touch_watch_t *w, int ticks) { return ago(w, ticks)[1] - ago(w, ticks + 1)[1]; }

/* The median of the last ticks: kind 0 of a level, 1 of rises, -1 of falls, 2 of what is above a slow mean. */
static float median(const touch_watch_t *w, int kind, int which)
{
    float values[MEDIAN];
    for (int k = 0; k < MEDIAN; k++)
        values[k] = kind == 0   ? ago(w, k)[which]
                    : kind == 2 ? w->means[back(w, k)][which]
                                : fmaxf((float)kind * change(w, k), 0);
    sort(values, MEDIAN);
    return (values[(MEDIAN - 1) / 2] + values[MEDIAN / 2]) / 2;
}

/* Which classifier decides on a tick: the first, or one for vibration or noise where the last ticks show it. Refuses
   a sensor that is more than 1.5 times as disturbed as in training. */
static int deciding(touch_watch_t *w, const float *found)
{
    int model = 0;
    float sorted[CALM], gauges[2];
    w->calm[0][w->calmed] = w->looked ? fabsf(found[LEVELS + 4] - w->shared) : 0;
    w->calm[1][w->calmed] = found[3];
    w->calmed = (w->calmed + 1) % CALM;
    w->shared = found[LEVELS + 4];
    memcpy(sorted, w->calm[0], sizeof sorted);
    place(sorted, CALM, CALMEST);
    gauges[0] = sorted[CALMEST];
    gauges[1] = w->calm[1][0];
    for (int k = 1; k < CALM; k++)
        gauges[1] = fminf(gauges[1], w->calm[1][k]);
    w->noise = fmaxf(gauges[1], LEAST_NOISE);
    w->is_refused = gauges[0] > look_most[0] || gauges[1] > look_most[1];
#if MODELS > 1
    static const int gauge_of[] = GAUGE_OF;
    for (int m = 1; m < MODELS; m++)
        if (gauges[gauge_of[m - 1]] > look_limits[m - 1])
            model = m;
#endif
    return model;
}

/* Features of a tick from its signals and those before it. */
static void look(touch_watch_t *w, const float *found, float *next)
{
    static const int minima[] = MINIMA, maxima[] = MAXIMA;
    w->model = deciding(w, found);
    w->at = (w->at + 1) % LOOK;
    w->looked += w->looked < LOOK;
    for (int k = 0; k < SLOW; k++)
        w->means[w->at][k] = found[LEVELS + 5 + 3 * k];
    for (int m = 0; m < MODELS; m++)
        for (int l = 0; l < LEVELS; l++)
            w->logs[m][w->at][l] =
                logf((l && w->looked == 1 ? look_idle[m * LEVELS + l] : found[l]) + look_offsets[m * LEVELS + l]);
    for (int l = 0; l < LEVELS; l++) {
        float now = ago(w, 0)[l], least = now, most = now;
        *next++ = now;
        for (int k = 0, past = 0; k < (int)(sizeof minima / sizeof *minima); k++) {
            for (; past <= minima[k]; past++)
                least = fminf(least, ago(w, past)[l]);
            *next++ = now - least;
        }
        for (int k = 0, past = 0; k < (int)(sizeof maxima / sizeof *maxima); k++) {
            for (; past <= maxima[k]; past++)
                most = fmaxf(most, ago(w, past)[l]);
            *next++ = now - most;
        }
        *next++ = now - median(w, 0, l);
    }
    float rise = fmaxf(change(w, 0), 0), fall = fmaxf(-change(w, 0), 0), highest = rise;
    for (int k = 1; k < RISES; k++)
        highest = fmaxf(highest, change(w, k));
    *next++ = rise;
    *next++ = fall;
    *next++ = rise - median(w, 1, 0);
    *next++ = fall - median(w, -1, 0);
    *next++ = highest;
    found += LEVELS; /* area, likeness to the tick before, centroid, what taxels share, changes */
    int first = w->looked == 1;
    *next++ = found[0];
    *next++ = first ? 0 : found[0] - w->area;
    *next++ = found[1];
    *next++ = first ? 0 : fabsf(found[2] - w->row) + fabsf(found[3] - w->col);
    for (int i = 0; i < CHANGES; i++) {
        float more = found[5 + i] - (i % 3 ? 0 : median(w, 2, i / 3)); /* a drift of all taxels cancels out */
        *next++ = copysignf(log1pf(fabsf(more) / look_sizes[w->model * CHANGES + i]), more);
    }
    *next++ = logf(w->noise);
    for (int i = 0; i < 4 * (MEANS - 1); i++)
        *next++ = asinhf(2 * found[5 + CHANGES + i] / w->noise);
    w->area = found[0];
    w->row = found[2];
    w->col = found[3];
}

/* Logarithm of the sum of two exponentials. */
static float log_add(float a, float b) { return fmaxf(a, b) + log1pf(expf(-fabsf(a - b))); }

/* Log-odds of touch, and of the beginning of one, as if all classes were equally frequent. */
static void judge(touch_watch_t *w, float *odds, float *begins)
{
    float likely[KINDS], *x = w->now.features;
    int m = w->model;
    for (int k = 0; k < KINDS; k++)
        likely[k] = look_bias[m * KINDS + k];
    for (int i = 0; i < LOOKS; i++) {
        float unit = fminf(fmaxf((x[i] - look_mean[m * LOOKS + i]) / look_sd[m * LOOKS + i], -CLIP), CLIP);
        for (int k = 0; k < KINDS; k++)
            likely[k] += look_weights[(m * KINDS + k) * LOOKS + i] * unit;
    }
    float touch = likely[1], other = likely[0];
    for (int k = 2; k < KINDS; k++) {
        touch = log_add(touch, likely[k]);
        other = log_add(other, likely[k]);
    }
    *odds = touch - likely[0] + look_shift[m];
    *begins = likely[1] - other;
}

static sign_t sensed(touch_watch_t *w, const float *tick)
{
    float signals[LEVELS + 5 + CHANGES + 4 * (MEANS - 1)], odds, begins;
    sign_t sign = {0, 0, 0, 0};
    feel(w, tick, signals);
    look(w, signals, w->now.features);
    judge(w, &odds, &begins);
    w->begun = begins > BEGUN ? AGES - 1 : w->begun > 0 ? w->begun - 1 : 0;
    if (w->lasts) {
        int is_clearer = w->is_known && begins > BEGINS && odds > GROWN * w->highest + JUMP; /* another begins */
        w->since++;
        w->highest = fmaxf(w->highest, odds);
        w->below = odds < w->level - DROP ? w->below + 1 : 0;
        w->held = w->below ? w->held : w->since;
        w->weak = odds < FADED * w->highest ? w->weak + 1 : 0;
        w->lasts = w->below < HOLD && w->weak < FADE && !is_clearer;
    } else if (odds > w->level && w->begun > 0) {
        w->since = w->held = w->lasts = 1;
        w->highest = odds;
        w->below = w->weak = w->is_known = 0;
    } else {
        w->since = 0;
        w->is_known = 1;
    }
    sign.report = !w->is_known && (float)w->held >= look_wait[w->model];
    w->is_known = w->is_known || sign.report;
    sign.since = sign.report || w->lasts ? w->since : 0;
    sign.lasts = w->lasts;
    sign.sure = odds >= w->level;
    return sign;
}
