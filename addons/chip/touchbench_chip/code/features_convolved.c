/* Two layers of filters over windows that overlap, as their frames come. Of the first layer the maps of one time are
   kept, which all windows share; of the second what has come together of each window that is open. */

/* A filter of the first layer over the frames from a time on: of each pool of taxels the most, after bias and ReLU.
   Frames that have not come are 0. */
static void filtered(const touch_t *t, int filter, int time, float *map)
{
    int frames = t->seen - time < KERNEL1_FRAMES ? t->seen - time : KERNEL1_FRAMES;
    for (int i = 0; i < MAP; i++) {
        const touch_weight_t *w = filters1 + filter * KERNEL1_FRAMES * KERNEL1_ROWS * KERNEL1_COLS;
        int corner = i / MAP_COLS * POOL1_ROWS * COLS + i % MAP_COLS * POOL1_COLS;
        float sum[POOL1_ROWS][POOL1_COLS] = {{0}}, most = -INFINITY;
        for (int k = 0; k < frames; k++)
            for (int r = 0; r < KERNEL1_ROWS; r++) {
                const float *x = t->ring[(time + k) % KERNEL1_FRAMES] + corner + r * COLS;
                for (int c = 0; c < KERNEL1_COLS; c++, w++, x++)
                    for (int down = 0; down < POOL1_ROWS; down++)
                        for (int right = 0; right < POOL1_COLS; right++)
                            sum[down][right] += (float)*w * x[down * COLS + right];
            }
        for (int down = 0; down < POOL1_ROWS; down++)
            for (int right = 0; right < POOL1_COLS; right++)
                most = fmaxf(most, sum[down][right]);
        map[i] = fmaxf(most * filters1_step[filter] + filters1_bias[filter], 0);
    }
}

/* What a map of a filter of the first layer, pooled from two times, adds to those of the second in a window. */
static void added(touch_t *t, int filter, int window, int place, const float *map)
{
    for (int g = 0; g < FILTERS2; g++)
        for (int k = 0; k < KERNEL2_FRAMES; k++) {
            if (place - k < 0 || place - k >= SUM_FRAMES)
                continue;
            const touch_weight_t *w = filters2 + ((g * FILTERS1 + filter) * KERNEL2_FRAMES + k) * KERNEL2_ROWS * KERNEL2_COLS;
            for (int down = 0; down < SUM_ROWS; down++)
                for (int right = 0; right < SUM_COLS; right++) {
                    const float *x = map + down * MAP_COLS + right;
                    float sum = 0;
                    for (int r = 0; r < KERNEL2_ROWS; r++)
                        for (int c = 0; c < KERNEL2_COLS; c++)
                            sum += (float)w[r * KERNEL2_COLS + c] * x[r * MAP_COLS + c];
                    t->sums[window % OPEN][g][place - k][down][right] += sum;
                }
        }
}

/* The first layer at a time, and what it adds to the open windows, of which one is the last. */
static void pass(touch_t *t, int time, int last)
{
    if (time == last * HOP)
        memset(t->sums[last % OPEN], 0, sizeof t->sums[0]);
    for (int filter = 0; filter < FILTERS1; filter++) {
        float *before = t->maps[filter], now[MAP], pooled[MAP];
        filtered(t, filter, time, now);
        for (int i = 0; i < MAP; i++) {
            pooled[i] = fmaxf(before[i], now[i]);
            before[i] = now[i];
        }
        for (int window = last; window >= 0 && time - window * HOP < USED; window--)
            if ((time - window * HOP) % 2) /* its second time, fourth time and so on */
                added(t, filter, window, (time - window * HOP) / 2, pooled);
    }
}

/* What the second layer tells of a window: of each pool the most, after bias and ReLU. */
static void features_of(touch_t *t, int window)
{
    float *x = t->features;
    for (int g = 0; g < FILTERS2; g++) {
        float (*sums)[SUM_ROWS][SUM_COLS] = t->sums[window % OPEN][g];
        for (int k = 0; k < SUM_FRAMES; k += 2)
            for (int r = 0; r < SUM_ROWS; r += POOL2_ROWS)
                for (int c = 0; c < SUM_COLS; c += POOL2_COLS) {
                    float most = -INFINITY;
                    for (int later = 0; later < 2; later++)
                        for (int down = 0; down < POOL2_ROWS; down++)
                            for (int right = 0; right < POOL2_COLS; right++)
                                most = fmaxf(most, sums[k + later][r + down][c + right]);
                    *x++ = fmaxf(most * filters2_step[g] + filters2_bias[g], 0);
                }
    }
}

/* A frame joins the open windows: 1 if one of them ends, whose features are known then. */
static int join(touch_t *t, const float *frame)
{
    for (int i = 0; i < TAXELS; i++)
        t->ring[t->seen % KERNEL1_FRAMES][i] = frame[i] / FULL_SCALE;
    t->seen++;
    int time = t->seen - KERNEL1_FRAMES; /* frames from here on have come */
    if (time >= 0)
        pass(t, time, time / HOP);
    if (t->seen != t->windows * HOP + WINDOW)
        return 0;
    features_of(t, t->windows);
    return 1;
}

/* Features of a window that has not ended, as if frames of 0 filled it; afterwards everything is as it was. */
static void features_until_now(touch_t *t)
{
    int time = t->seen < KERNEL1_FRAMES ? 0 : t->seen - KERNEL1_FRAMES + 1;
    memcpy(t->kept_maps, t->maps, sizeof t->maps);
    memcpy(t->kept_sums, t->sums[t->windows % OPEN], sizeof t->sums[0]);
    for (; time < t->windows * HOP + USED; time++)
        pass(t, time, t->windows);
    features_of(t, t->windows);
    memcpy(t->maps, t->kept_maps, sizeof t->maps);
    memcpy(t->sums[t->windows % OPEN], t->kept_sums, sizeof t->sums[0]);
}
