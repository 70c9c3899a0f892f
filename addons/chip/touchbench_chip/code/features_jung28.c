/* The features of Jung et al. 2014 of a capture so far; of each frame, its sum alone is kept. */

/* A frame joins what is known of the capture; q is the frame before. */
static void join(touch_t *t, const float *p, const float *q)
{
    float n = (float)(t->seen + 1), total = 0, peak = 0, change = 0, row = 0, col = 0, above = 0;
    for (int r = 0; r < ROWS; r++) {
        float sum = 0;
        for (int c = 0; c < COLS; c++)
            sum += p[r * COLS + c];
        t->row[r] += (sum - t->row[r]) / n;
        total += sum;
        row += sum * (float)(r + 1);
    }
    for (int c = 0; c < COLS; c++) {
        float sum = 0;
        for (int r = 0; r < ROWS; r++)
            sum += p[r * COLS + c];
        t->col[c] += (sum - t->col[c]) / n;
        col += sum * (float)(c + 1);
    }
    for (int i = 0; i < TAXELS; i++) {
        peak = fmaxf(peak, p[i]);
        change += t->seen ? fabsf(p[i] - q[i]) : 0;
    }
    for (int i = 0; i < TAXELS; i++)
        above += p[i] > peak * 0.5f;
    row = total > 0 ? row / total : (ROWS + 1) / 2.0f;
    col = total > 0 ? col / total : (COLS + 1) / 2.0f;
    t->change += t->seen ? (change - t->change) / (n - 1) : 0;
    t->area += (above / TAXELS - t->area) / n;
    t->distance[0] += t->seen ? fabsf(row - t->centre[0]) : 0;
    t->distance[1] += t->seen ? fabsf(col - t->centre[1]) : 0;
    t->centre[0] = row;
    t->centre[1] = col;
    t->highest = fmaxf(t->highest, peak);
    if (t->seen == 0 || total > t->highest_total) {
        t->highest_total = total;
        t->area_there = above / TAXELS;
    }
    t->total[t->seen] = total;
}

static float crossings(const touch_t *t, float threshold)
{
    int count = 0;
    for (int i = 1; i < t->seen; i++)
        count += t->total[i] > threshold && !(t->total[i - 1] > threshold);
    return (float)count;
}

static void features_of(touch_t *t)
{
    float *x = t->features, n = (float)t->seen, mean = 0, variance = 0, steps = n > 1 ? n - 1 : 1;
    for (int i = 0; i < t->seen; i++)
        mean += (t->total[i] - mean) / (float)(i + 1);
    for (int i = 0; i < t->seen; i++)
        variance += (t->total[i] - mean) * (t->total[i] - mean);
    *x++ = mean / TAXELS;
    *x++ = t->highest;
    *x++ = t->change;
    for (int r = 0; r < ROWS; r++)
        *x++ = t->row[r] / COLS;
    for (int c = 0; c < COLS; c++)
        *x++ = t->col[c] / ROWS;
    *x++ = t->area;
    *x++ = t->area_there;
    *x++ = crossings(t, mean + sqrtf(variance / n));
    *x++ = crossings(t, mean);
    for (int side = 0; side < 2; side++) {
        *x++ = t->distance[side] / steps;
        *x++ = t->distance[side];
    }
    *x++ = n;
}
