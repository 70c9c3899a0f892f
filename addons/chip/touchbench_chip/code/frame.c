/* A frame before features are taken of it: checked, repaired, scaled. Everything is causal. */

#if REPAIR_STUCK || REPAIR_DEAD
#define REPAIRS 1
#else
#define REPAIRS 0
#endif

#if REPAIRS
/* Sum over the up to 8 neighbours of a taxel, column by column, then without the taxel itself. */
static float around(const float *values, int row, int col)
{
    float sum = 0;
    for (int c = col - 1; c <= col + 1; c++) {
        float column = 0;
        for (int r = row - 1; r <= row + 1; r++)
            if (r >= 0 && r < ROWS && c >= 0 && c < COLS)
                column += values[r * COLS + c];
        sum += column;
    }
    return sum - values[row * COLS + col];
}

/* Broken taxels as the mean of their sound neighbours; those without one are filled from filled ones. */
static void fill(touch_t *t, float *x)
{
    for (int pass = 0; pass < PASSES; pass++) {
        int filled = 0;
        for (int i = 0; i < TAXELS; i++)
            t->mean_around[i] = -1;
        for (int i = 0; i < TAXELS; i++) {
            if (t->sound[i] != 0)
                continue;
            float count = around(t->sound, i / COLS, i % COLS);
            if (count > 0) {
                t->mean_around[i] = around(x, i / COLS, i % COLS) / fmaxf(count, 1);
                filled = 1;
            }
        }
        if (!filled)
            return;
        for (int i = 0; i < TAXELS; i++)
            if (t->mean_around[i] >= 0) {
                x[i] = t->mean_around[i];
                t->sound[i] = 1;
            }
    }
}

/* Taxels that are stuck or dead, as far as the capture has shown until now. */
static void repair(touch_t *t, float *x)
{
    float varied = -1;
    int long_enough = t->seen + 1 >= SETTLED, broken = 0;
    for (int i = 0; i < TAXELS; i++) {
        t->least[i] = t->seen ? fminf(t->least[i], x[i]) : x[i];
        t->most[i] = t->seen ? fmaxf(t->most[i], x[i]) : x[i];
        if (t->least[i] != t->most[i])
            varied = fmaxf(varied, x[i]);
        t->moved[i] = t->least[i] != t->most[i];
    }
    for (int i = 0; i < TAXELS; i++) {
        int still = long_enough && t->moved[i] == 0, bad = 0;
#if REPAIR_STUCK
        bad |= t->least[i] >= FULL_SCALE;
        bad |= still && x[i] > varied && varied >= 0;
#endif
#if REPAIR_DEAD
        if (still) {
            int row = i / COLS, col = i % COLS;
            int sides = ((row > 0) + 1 + (row < ROWS - 1)) * ((col > 0) + 1 + (col < COLS - 1)) - 1;
            bad |= 2 * around(t->moved, row, col) > (float)sides;
        }
#endif
        t->sound[i] = !bad;
        broken |= bad;
    }
    if (!broken)
        return;
    for (int i = 0; i < TAXELS; i++)
        if (t->sound[i] == 0)
            x[i] = 0;
    fill(t, x);
}
#endif

#if REPAIR_NOISE
/* Variance of the noise, by the last steps; a quarter of the rows and columns have less. */
static float measure_noise(touch_t *t, const float *x, const float *before)
{
    float *newest = t->steps[t->newest_step], sums[ROWS + COLS] = {0};
    t->newest_step = (t->newest_step + 1) % NOISE_STEPS;
    t->held_steps += t->held_steps < NOISE_STEPS;
    for (int k = 0; k < ROWS + COLS; k++)
        newest[k] = 0;
    for (int i = 0; i < TAXELS; i++) {
        float square = (x[i] - before[i]) * (x[i] - before[i]) / 2;
        newest[i / COLS] += square / COLS;
        newest[ROWS + i % COLS] += square / ROWS;
    }
    for (int step = 0; step < t->held_steps; step++)
        for (int k = 0; k < ROWS + COLS; k++)
            sums[k] += t->steps[step][k];
    for (int k = 0; k < ROWS + COLS; k++) {
        int less = 0, same = 0;
        for (int l = 0; l < ROWS + COLS; l++) {
            less += sums[l] < sums[k];
            same += sums[l] == sums[k];
        }
        if (less <= QUIET && QUIET < less + same)
            return sums[k] / (float)t->held_steps;
    }
    return 0;
}

/* The middle one of the last frames; each reading goes to the mean about it by the share of noise in the variance. */
static void denoise(touch_t *t, float *x)
{
    float noise = t->held ? measure_noise(t, x, t->recent[t->newest]) : 0;
    t->newest = t->held ? (t->newest + 1) % DENOISED : 0;
    t->held += t->held < DENOISED;
    int back = t->held > DENOISED / 2 ? DENOISED / 2 : t->held - 1;
    const float *middle = t->recent[(t->newest + DENOISED - back) % DENOISED];
    for (int i = 0; i < TAXELS; i++) {
        float mean = 0, variance = 0;
        t->recent[t->newest][i] = x[i];
        for (int k = 0; k < t->held; k++)
            mean += t->recent[k][i] / (float)t->held;
        for (int k = 0; k < t->held; k++)
            variance += (t->recent[k][i] - mean) * (t->recent[k][i] - mean) / (float)t->held;
        t->mean[i] = mean;
        t->variance[i] = variance;
    }
    for (int i = 0; i < TAXELS; i++) {
        int row = i / COLS, top = row > 0 ? row - 1 : 0, bottom = row + 1 < ROWS ? row + 1 : row;
        int col = i % COLS, left = col > 0 ? col - 1 : 0, right = col + 1 < COLS ? col + 1 : col;
        float count = (float)((bottom - top + 1) * (right - left + 1)), mean = 0, variance = 0;
        for (int r = top; r <= bottom; r++)
            for (int c = left; c <= right; c++)
                mean += t->mean[r * COLS + c] / count;
        for (int r = top; r <= bottom; r++)
            for (int c = left; c <= right; c++) {
                float away = t->mean[r * COLS + c] - mean;
                variance += (t->variance[r * COLS + c] + away * away) / count;
            }
        x[i] = mean + (variance > noise ? (variance - noise) / variance * (middle[i] - mean) : 0);
    }
}
#endif

/* The readings of a frame as shares of full scale, after repair and scaling. */
static void prepared(touch_t *t, float *x)
{
    (void)t;
    (void)x;
#if REPAIRS
    repair(t, x);
#endif
#if REPAIR_OFFSET
    for (int i = 0; i < TAXELS; i++) {
        t->offset[i] = t->seen ? fminf(t->offset[i], x[i]) : x[i];
        x[i] -= t->offset[i];
    }
#endif
#if REPAIR_NOISE
    denoise(t, x);
#endif
#if SCALE_PEAK
    for (int i = 0; i < TAXELS; i++)
        t->peak = fmaxf(t->peak, x[i]);
    float gain = FULL_SCALE / (t->peak > 0 ? t->peak : 1);
    for (int i = 0; i < TAXELS; i++)
        x[i] = fminf(x[i] * gain, FULL_SCALE);
#endif
}
