/* 427 features of a window: statistics of 19 signals, and of the taxels in order of size. */

static const int of_steps[SIGNALS] = {0, 0, 1, 1, 1, 1, 1, 0, 0, 0, 0, 0, 0, 1, 1, 1, 1, 1, 1};
static const int spectral[SPECTRAL] = {0, 2, 7, 8, 4, 5, 16, 17, 11};
static const int lagged[LAGGED] = {0, 7, 8};
static const int lags[LAGS] = LAG_FRAMES;
static const int quantiles[5] = {5, 25, 50, 75, 95};
static const int edges[BANDS + 1] = {0, 1, 2, 3, 4, 6, 8, 12, 16, 24, 32}; /* in 32nds of half the rate */

enum {
    SPECTRA = STATISTICS * SIGNALS, /* features before those of spectra, and of the taxels; steps to all */
    OF_TAXELS = SPECTRA + (BANDS + 2) * SPECTRAL + LAGS * LAGGED + 3,
    OF_PROFILES = OF_TAXELS + 3 * (SPREAD + 1),
    THIRDS = 3, /* of the covariances of rows, and of columns: a step each */
    FEATURE_STEPS = SIGNALS + SPECTRAL + 3 + 2 * THIRDS * PROFILES
};

static float ratio(float a, float b) { return b > 0 ? a / b : 0; }

static float within(float x, float low, float high) { return fminf(fmaxf(x, low), high); }

/* Half the difference of the neighbours along a side, 0 at the edges; of two taxels, their difference. */
static float gradient(const float *p, int at, int place, int count, int stride)
{
    if (count == 2)
        return p[at + (1 - place) * stride] - p[at - place * stride];
    return place > 0 && place < count - 1 ? (p[at + stride] - p[at - stride]) * 0.5f : 0;
}

/* The shift between two frames that explains the step best, in taxels, and how much of the step it explains. */
static void flow(const float *p, const float *q, float *v, float *u, float *explained)
{
    float rr = 0, cc = 0, rc = 0, rt = 0, ct = 0, size = 0;
    for (int r = 0; r < ROWS; r++)
        for (int c = 0; c < COLS; c++) {
            int i = r * COLS + c;
            float down = 0.5f * (gradient(p, i, r, ROWS, COLS) + gradient(q, i, r, ROWS, COLS));
            float right = 0.5f * (gradient(p, i, c, COLS, 1) + gradient(q, i, c, COLS, 1));
            float step = p[i] - q[i];
            rr += down * down;
            cc += right * right;
            rc += down * right;
            rt -= down * step;
            ct -= right * step;
            size += step * step;
        }
    float ridge = 1e-5f + 0.01f * (rr + cc);
    float determinant = (rr + ridge) * (cc + ridge) - rc * rc;
    float a = ((cc + ridge) * rt - rc * ct) / determinant, b = ((rr + ridge) * ct - rc * rt) / determinant;
    *explained = within(ratio(a * rt + b * ct, size), 0, 1);
    *v = within(a, -2, 2);
    *u = within(b, -2, 2);
}

/* The signals of a frame p of shares, and of its step from q, the frame before; x holds SIGNALS numbers. */
static void signals_of(const float *p, const float *q, float *x)
{
    float total = 0, before = 0, peak = p[0], square = 0, square_before = 0, change = 0, alike = 0;
    float row = 0, col = 0, row_before = 0, col_before = 0;
    for (int r = 0; r < ROWS; r++) {
        float sum = 0, sum_before = 0;
        for (int c = 0; c < COLS; c++) {
            int i = r * COLS + c;
            sum += p[i];
            sum_before += q[i];
            peak = fmaxf(peak, p[i]);
            square += p[i] * p[i];
            square_before += q[i] * q[i];
            change += fabsf(p[i] - q[i]);
            alike += p[i] * q[i];
            col += p[i] * ((float)c + 0.5f) / COLS;
            col_before += q[i] * ((float)c + 0.5f) / COLS;
        }
        total += sum;
        before += sum_before;
        row += sum * ((float)r + 0.5f) / ROWS;
        row_before += sum_before * ((float)r + 0.5f) / ROWS;
    }
    row = total > 0 ? row / total : 0.5f;
    col = total > 0 ? col / total : 0.5f;
    row_before = before > 0 ? row_before / before : 0.5f;
    col_before = before > 0 ? col_before / before : 0.5f;
    float high = 0, wide = 0, askew = 0, above = 0;
    for (int r = 0; r < ROWS; r++)
        for (int c = 0; c < COLS; c++) {
            float value = p[r * COLS + c];
            float down = ((float)r + 0.5f) / ROWS - row, right = ((float)c + 0.5f) / COLS - col;
            high += value * down * down;
            wide += value * right * right;
            askew += value * down * right;
            above += value > peak * 0.5f;
        }
    high = ratio(high, total);
    wide = ratio(wide, total);
    askew = ratio(askew, total);
    float spread = sqrtf(fmaxf(high + wide, 0)), net = total - before;
    float long_side = sqrtf((high - wide) * (high - wide) + 4 * askew * askew);
    float down = row - row_before, right = col - col_before, v, u, explained;
    float travel = sqrtf(down * down + right * right);
    flow(p, q, &v, &u, &explained);
    float lengths = sqrtf(square) * sqrtf(square_before);
    x[0] = logf(total / TAXELS + EPS);
    x[1] = logf(peak + EPS);
    x[2] = logf(change / TAXELS + EPS);
    x[3] = logf(fmaxf(change + net, 0) / 2 / TAXELS + EPS);
    x[4] = ratio(change, total + before);
    x[5] = ratio(net, total + before);
    x[6] = ratio(fabsf(net), change);
    x[7] = row;
    x[8] = col;
    x[9] = spread;
    x[10] = within(spread > 1e-3f ? ratio(long_side, high + wide) : 0, 0, 1);
    x[11] = above / TAXELS;
    x[12] = ratio(total * total, square) / TAXELS;
    x[13] = logf((travel > 1e-6f ? travel : 0) + 1e-3f); /* sums in single precision move the centre by less */
    x[14] = logf(sqrtf(v * v + u * u) + 1e-2f);
    x[15] = explained;
    x[16] = v;
    x[17] = u;
    x[18] = lengths > 0 ? alike / lengths : 1;
}

/* Shell sort, rising. */
static void sort(float *x, int n)
{
    for (int gap = n / 2; gap > 0; gap = gap == 2 ? 1 : gap * 5 / 11)
        for (int i = gap; i < n; i++) {
            float value = x[i];
            int j = i;
            for (; j >= gap && x[j - gap] > value; j -= gap)
                x[j] = x[j - gap];
            x[j] = value;
        }
}

/* One statistic after the other of a signal over n frames; leaves it centred. Returns its variance. */
static float describe(touch_t *t, float *x, int n, int signal, float *found)
{
    float *sorted = t->sorted, mean = 0, variance = 0, third = 0, fourth = 0, least = x[0], most = x[0];
    for (int i = 0; i < n; i++) {
        sorted[i] = x[i];
        mean += x[i];
        least = fminf(least, x[i]);
        most = fmaxf(most, x[i]);
    }
    sort(sorted, n);
    for (int k = 0; k < 5; k++) {
        float at = (float)((n - 1) * quantiles[k]) / 100;
        int low = (n - 1) * quantiles[k] / 100, high = low + 1 < n ? low + 1 : n - 1;
        float part = at - (float)low;
        found[k * SIGNALS + signal] = sorted[low] * (1 - part) + sorted[high] * part;
    }
    mean = least == most ? least : mean / (float)n;
    float sizes = 0, steps = 0, steps_square = 0;
    int crossings = 0, turns = 0;
    float slope = 0;
    float before = x[0];
    for (int i = 0; i < n; i++) {
        float step = x[i] - before;
        before = x[i];
        x[i] -= mean;
        float square = x[i] * x[i];
        variance += square;
        third += square * x[i];
        fourth += square * square;
        if (i == 0)
            continue;
        sizes += fabsf(step);
        steps += step;
        crossings += (x[i] > 0) != (x[i - 1] > 0);
        turns += i > 1 && ((step < 0 && slope > 0) || (step > 0 && slope < 0));
        slope = step;
    }
    variance /= (float)n;
    float sd = sqrtf(variance), mean_step = n > 1 ? steps / (float)(n - 1) : 0;
    for (int i = 1; i < n; i++) {
        float away = x[i] - x[i - 1] - mean_step;
        steps_square += away * away;
    }
    int varies = sd > 1e-6f * fabsf(mean) + 1e-12f;
    float *next = found + 5 * SIGNALS + signal;
    next[0] = mean;
    next[SIGNALS] = sd;
    next[2 * SIGNALS] = n > 1 ? sizes / (float)(n - 1) : 0;
    next[3 * SIGNALS] = n > 1 ? sqrtf(steps_square / (float)(n - 1)) : 0;
    next[4 * SIGNALS] = n > 1 ? (float)crossings / (float)(n - 1) : 0;
    next[5 * SIGNALS] = n > 1 ? (float)turns / (float)(n > 2 ? n - 2 : 1) : 0;
    next[6 * SIGNALS] = varies ? third / (float)n / (sd * sd * sd) : 0;
    next[7 * SIGNALS] = varies ? within(fourth / (float)n / (variance * variance), 0, 30) : 3;
    return variance;
}

/* Log shares of the power of a centred signal in bands, log power, and centroid; Hann windows, half overlapping. */
static void spectrum(touch_t *t, const float *x, int n, int place, float *found)
{
    int length = n < SEGMENT ? n : SEGMENT, points = length > POINTS ? length : POINTS, segments = 0;
    int hop = length / 2 > 1 ? length / 2 : 1, bins = points / 2;
    float *power = t->power, window_square = 0, total = 0, centroid = 0;
    if (n < 2) {
        for (int k = 0; k < BANDS + 2; k++)
            found[k * SPECTRAL + place] = 0;
        return;
    }
    if (t->points != points)
        for (int i = 0; i < points; i++) {
            t->cosine[i] = cosf(2 * PI * (float)i / (float)points);
            t->sine[i] = sinf(2 * PI * (float)i / (float)points);
        }
    t->points = points;
    for (int k = 0; k < bins; k++)
        power[k] = 0;
    for (int begin = 0; begin + length <= n; begin += hop, segments++) {
        float *part = t->sorted, mean = 0;
        for (int i = 0; i < length; i++)
            mean += x[begin + i];
        mean /= (float)length;
        window_square = 0;
        for (int i = 0; i < length; i++) {
            float weight = 0.5f - 0.5f * cosf(2 * PI * (float)(i + 1) / (float)(length + 1));
            part[i] = (x[begin + i] - mean) * weight;
            window_square += weight * weight;
        }
        for (int i = length; i < points; i++)
            part[i] = 0;
        for (int i = 1; 2 * i < points; i++) { /* sums and differences of values with the same cosine */
            float other = part[points - i];
            part[points - i] = part[i] - other;
            part[i] += other;
        }
        for (int k = 1; k <= bins; k++) {
            float re = part[0], im = 0;
            int angle = 0;
            if (points % 2 == 0)
                re += k % 2 ? -part[bins] : part[bins];
            for (int i = 1; 2 * i < points; i++) {
                angle += k;
                if (angle >= points)
                    angle -= points;
                re += part[i] * t->cosine[angle];
                im += part[points - i] * t->sine[angle];
            }
            power[k - 1] += re * re + im * im;
        }
    }
    for (int k = 0; k < bins; k++) {
        power[k] /= (float)segments * window_square * (float)points;
        total += power[k];
        centroid += power[k] * (float)(k + 1) / (float)points;
    }
    for (int band = 0; band < BANDS; band++) {
        int first = edges[band] * points / 64, end = band + 1 < BANDS ? edges[band + 1] * points / 64 : bins;
        float sum = power[first];
        for (int k = first + 1; k < end; k++)
            sum += power[k];
        found[band * SPECTRAL + place] = logf((sum + 1e-6f * total + 1e-12f) / (total + 1e-12f));
    }
    found[BANDS * SPECTRAL + place] = logf(total + 1e-8f);
    found[(BANDS + 1) * SPECTRAL + place] = ratio(centroid, total);
}

/* Sorted values of the taxels, read at 16 places from the largest to the smallest, and their entropy. */
static void space(float *values, float *found)
{
    float sum = 0, entropy = 0;
    for (int i = 0; i < TAXELS; i++)
        sum += values[i];
    sum = fmaxf(sum, 1e-9f);
    for (int i = 0; i < TAXELS; i++)
        entropy -= values[i] / sum * logf(values[i] / sum + 1e-9f);
    sort(values, TAXELS);
    for (int k = 0; k < SPREAD; k++) {
        int numerator = k * (TAXELS - 1), low = numerator / (SPREAD - 1), high = low + 1 < TAXELS ? low + 1 : TAXELS - 1;
        float part = (float)(numerator % (SPREAD - 1)) / (SPREAD - 1);
        found[k] = logf(values[TAXELS - 1 - low] * (1 - part) + values[TAXELS - 1 - high] * part + EPS);
    }
    found[SPREAD] = TAXELS > 1 ? entropy / fmaxf(logf((float)TAXELS), 1e-9f) : 0;
}

#if STEPPED
/* What a taxel did over several parts: its mean (kind 0), SD (1) or largest value (2); in steps, so sums are exact. */
static float over(const touch_part_t *const *parts, int count, int kind, int i)
{
    uint64_t n = 0, sum = 0, squares = 0, most = 0;
    for (int k = 0; k < count; k++) {
        const touch_part_t *b = parts[k];
        n += (uint64_t)b->n;
        sum += b->n ? b->sum[i] : 0;
        squares += b->n ? b->squares[i] : 0;
        most = b->n && b->most[i] > most ? b->most[i] : most;
    }
    float spread = (float)(n * squares - sum * sum) / ((float)n * (float)n);
    return (kind == 0 ? (float)sum / (float)n : kind == 1 ? sqrtf(spread) : (float)most) / STEPS;
}

/* A frame of shares joins the sum of each taxel, that of its squares and its largest value. */
static void join(touch_part_t *part, const float *p)
{
    part->n++;
    for (int i = 0; i < TAXELS; i++) {
        uint32_t reading = (uint32_t)(p[i] * STEPS + 0.5f);
        part->sum[i] = (touch_sum_t)(part->sum[i] + reading);
        part->squares[i] += reading * reading;
        part->most[i] = reading > part->most[i] ? (touch_most_t)reading : part->most[i];
    }
}

static void forget(touch_part_t *part) { memset(part, 0, sizeof *part); }
#else
/* What a taxel did over several parts that follow one another: its mean (kind 0), SD (1) or largest value (2). */
static float over(const touch_part_t *const *parts, int count, int kind, int i)
{
    float n = 0, mean = 0, m2 = 0, most = 0;
    for (int k = 0; k < count; k++) {
        const touch_part_t *b = parts[k];
        if (!b->n)
            continue;
        float second = (float)b->n, away = b->mean[i] - mean;
        m2 = n > 0 ? m2 + b->m2[i] + away * away * n * second / (n + second) : b->m2[i];
        mean = n > 0 ? mean + away * second / (n + second) : b->mean[i];
        most = fmaxf(most, b->most[i]);
        n += second;
    }
    return kind == 0 ? mean : kind == 1 ? sqrtf(m2 / n) : most;
}

/* A frame joins the mean, the squares about it and the largest value of each taxel (Welford). */
static void join(touch_part_t *part, const float *p)
{
    part->n++;
    for (int i = 0; i < TAXELS; i++) {
        float away = p[i] - part->mean[i];
        part->mean[i] += away / (float)part->n;
        part->m2[i] += away * (p[i] - part->mean[i]);
        part->most[i] = fmaxf(part->most[i], p[i]);
    }
}

static void forget(touch_part_t *part)
{
    part->n = 0;
    for (int i = 0; i < TAXELS; i++)
        part->mean[i] = part->m2[i] = part->most[i] = 0;
}
#endif

/* A signal in the n frames before frame `end`, into t->series, and its range. */
static float fetch(touch_t *t, int end, int n, int s)
{
    float *series = t->series;
    int begin = end - n;
    for (int i = 0; i < n; i++)
        series[i] = t->signals[(begin + i) % RING][s];
    if (of_steps[s])
        series[0] = n > 1 ? series[1] : 0;
    float least = series[0], most = series[0];
    for (int i = 1; i < n; i++) {
        least = fminf(least, series[i]);
        most = fmaxf(most, series[i]);
    }
    if (most - least > STILL * fmaxf(fabsf(series[0]), 1))
        return most - least;
    for (int i = 1; i < n; i++) /* rounding moved it */
        series[i] = series[0];
    return 0;
}

/* Features of a signal but for its spectrum; those of COL also use those of ROW, which precede them. */
static void signal_features(touch_t *t, int end, int n, int s)
{
    float *found = t->features, *series = t->series, *after = found + SPECTRA + (BANDS + 2) * SPECTRAL;
    float *ranges = after + LAGS * LAGGED, range = fetch(t, end, n, s), variance = describe(t, series, n, s, found);
    for (int k = 0; k < LAGGED; k++)
        if (lagged[k] == s)
            for (int l = 0; l < LAGS; l++) {
                float sum = 0;
                for (int i = lags[l]; i < n; i++)
                    sum += series[i] * series[i - lags[l]];
                after[l * LAGGED + k] = lags[l] < n && variance > 1e-12f ? sum / (float)n / variance : 0;
            }
    if (s == ROW || s == COL)
        ranges[s - ROW] = range;
    if (s == ROW)
        for (int i = 0; i < n; i++)
            t->centre[i] = series[i];
    if (s == COL) {
        float sum = 0, square = 0;
        for (int i = 0; i < n; i++) {
            sum += t->centre[i] * series[i];
            square += t->centre[i] * t->centre[i];
        }
        ranges[2] = sum / (float)n / sqrtf(square / (float)n * variance + 1e-9f);
    }
}

#if PROFILES
/* A third of the covariances of some lines, rows or columns, in the n frames before frame `end`: with themselves or the
   next ones. */
static void covariances(const touch_t *t, int end, int n, int first, int lines, int third, float *found)
{
    static const int pair_lags[PAIRS] = PAIR_FRAMES, shifts[PAIRS] = PAIR_SHIFTS;
    float means[ROWS > COLS ? ROWS : COLS];
    for (int l = 0; l < lines; l++) {
        means[l] = 0;
        for (int i = end - n; i < end; i++)
            means[l] += t->profiles[i % RING][first + l];
        means[l] /= (float)n;
    }
    for (int k = PAIRS * third / THIRDS; k < PAIRS * (third + 1) / THIRDS; k++) {
        int lag = pair_lags[k], shift = shifts[k], low = shift < 0 ? -shift : 0, high = lines - (shift > 0 ? shift : 0);
        int pairs = (n - lag) * (high - low);
        float sum = 0;
        for (int i = end - n + lag; i < end; i++) {
            const float *later = &t->profiles[i % RING][first], *earlier = &t->profiles[(i - lag) % RING][first];
            for (int l = low; l < high; l++)
                sum += (earlier[l] - means[l]) * (later[l + shift] - means[l + shift]);
        }
        found[k] = pairs > 0 ? asinhf(sum / (float)pairs / COVARIANCE_SCALE) : 0;
    }
}
#endif

/* A step of the features of the n frames before frame `end`: a signal, then a spectrum, then a number of the taxels,
   after the other. The parts hold what the taxels did in these frames. */
static void feature_step(touch_t *t, int end, int n, const touch_part_t *const *parts, int count, int step)
{
    float *found = t->features;
    if (step < SIGNALS) {
        signal_features(t, end, n, step);
    } else if (step < SIGNALS + SPECTRAL) {
        int place = step - SIGNALS, s = spectral[place];
        fetch(t, end, n, s);
        for (int i = 0; i < n; i++)
            t->series[i] -= found[5 * SIGNALS + s]; /* its mean */
        spectrum(t, t->series, n, place, found + SPECTRA);
#if PROFILES
    } else if (step >= SIGNALS + SPECTRAL + 3) {
        int place = step - SIGNALS - SPECTRAL - 3, is_cols = place >= THIRDS, first = is_cols ? ROWS : 0;
        float *of_lines = found + OF_PROFILES + is_cols * PAIRS;
        covariances(t, end, n, first, is_cols ? COLS : ROWS, place % THIRDS, of_lines);
#endif
    } else {
        int kind = step - SIGNALS - SPECTRAL;
        for (int i = 0; i < TAXELS; i++)
            t->taxels[i] = over(parts, count, kind, i);
        space(t->taxels, found + OF_TAXELS + kind * (SPREAD + 1));
    }
}

/* Features of the last n frames. */
static void features_of(touch_t *t, int n, const touch_part_t *const *parts, int count)
{
    for (int step = 0; step < FEATURE_STEPS; step++)
        feature_step(t, t->seen, n, parts, count, step);
}

/* A frame joins the half of a window that it lies in; whether a window of that length ends with it. */
static int halves(touch_part_t *parts, const float *p, int at, int window, int hop)
{
    if (window == 1) {
        forget(&parts[0]);
        forget(&parts[1]);
    }
    if (at % hop == 0)
        forget(&parts[at / hop % 2]);
    join(&parts[at / hop % 2], p);
    return at + 1 >= window && (at + 1 - window) % hop == 0;
}

/* Features of the last n frames, which lie in two halves. */
static void features_of_halves(touch_t *t, int n, const touch_part_t *halves)
{
    const touch_part_t *parts[] = {halves, halves + 1};
    features_of(t, n, parts, 2);
}

/* The readings of a frame, none below 0, repaired. */
static void read_frame(touch_t *t, const float *frame)
{
    for (int i = 0; i < TAXELS; i++)
        t->frame[i] = fmaxf(frame[i], 0);
    prepared(t, t->frame);
}

/* The frame that was read as shares of full scale, and its signals, which join those before it. */
static void join_signals(touch_t *t)
{
    for (int i = 0; i < TAXELS; i++) {
        t->frame[i] /= FULL_SCALE;
        t->before[i] = t->seen ? t->before[i] : t->frame[i];
    }
    signals_of(t->frame, t->before, t->signals[t->seen % RING]);
#if PROFILES
    float *profile = t->profiles[t->seen % RING];
    for (int k = 0; k < ROWS + COLS; k++)
        profile[k] = 0;
    for (int i = 0; i < TAXELS; i++) {
        profile[i / COLS] += t->frame[i] / COLS;
        profile[ROWS + i % COLS] += t->frame[i] / ROWS;
    }
#endif
}

static void take(touch_t *t, const float *frame)
{
    read_frame(t, frame);
    join_signals(t);
}
