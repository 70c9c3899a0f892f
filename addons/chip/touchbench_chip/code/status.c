/* Whether to trust the sensor: numbers of background and of touches, compared with their range in training. */

enum { REPEATS = 4, FIRST_CALM = QUIETS, FIRST_TOUCHED = QUIETS + CALMS, TOUCH_REPEATS = FIRST_TOUCHED + 8, PACE = 9 };

/* Reasons from the means of a block, besides known ones. Repeated frames explain all others, and any other explains
   turns and pace. */
static unsigned judge_block(const float *means, int first, int count, unsigned known)
{
    unsigned status = 0;
    for (int k = first; k < first + count; k++) {
        float mean = means[k - first];
        if (mean < status_low[k]) {
            status |= (unsigned)status_below[k];
        } else if (mean > status_high[k]) {
            status |= (unsigned)status_above[k];
            if (k == REPEATS || k == TOUCH_REPEATS)
                return TOUCH_RATE;
        }
    }
    return (status | known) & ~(unsigned)TOUCH_RATE ? status & ~(unsigned)TOUCH_RATE : status;
}

/* A frame joins the numbers of its tick, and of the touch that lasts; one without a previous frame is only kept. */
static void examine_frame(touch_health_t *h, const float *frame)
{
    float sum = 0, moved = 0, step = 0, top = 0;
    uint32_t tops = 0;
    for (int i = 0; i < TAXELS; i++) {
        float value = frame[i] > 0 ? frame[i] : 0, change = value - h->last[i];
        if (h->follows && change != 0)
            h->moved[i / 8] |= (uint8_t)(1u << i % 8);
        h->last[i] = value;
        sum += value;
        moved += fabsf(change);
        step += change;
        tops = value > top ? 1 : tops + (value == top);
        top = value > top ? value : top;
    }
    if (!h->follows) {
        h->follows = 1;
        h->step = 0;
        return;
    }
    int repeats = moved == 0 && sum > 0;
    h->tick[0] += sum / TAXELS / FULL_SCALE;
    h->tick[1] += moved / TAXELS / FULL_SCALE;
    h->tick[2] += fabsf(step) / TAXELS / FULL_SCALE;
    h->tick[3] += step * h->step < 0;
    h->tick[4] += (float)repeats;
    h->step = step;
    h->tick_frames++;
    if (!h->is_lasting)
        return;
    h->at_largest = top > h->look.largest ? tops : h->at_largest + (top == h->look.largest ? tops : 0);
    h->repeated += repeats;
    join_look(&h->look, h->last);
}

/* The pace of a touch, from the features of its longest name: 1 if every second frame is lost, -1 if there are twice
   as many. */
static void measure_pace(touch_health_t *h, const float *features, int frames)
{
    float pace = PACE_BIAS;
    if (frames < h->pace_frames)
        return;
    for (int k = 0; k < PACES; k++)
        pace += pace_weights[k] * features[pace_places[k]];
    h->pace = fminf(fmaxf(pace, -MOST_PACE), MOST_PACE);
    h->pace_frames = frames;
}

/* A touch joins the numbers of its block, which may be the last of the block. */
static void finish_touch(touch_health_t *h)
{
    float numbers[7];
    look_numbers(&h->look, numbers);
    for (int k = 0; k < 7; k++)
        h->touched[k] += logf(numbers[k]);
    h->touched[7] += logf((float)h->at_largest / (float)h->look.frames);
    h->touched[8] += (float)h->repeated / (float)h->look.frames;
    h->touched[PACE] += h->pace;
    if (++h->touches < TOUCHES)
        return;
    for (int k = 0; k < TOUCHEDS; k++)
        h->touched[k] /= TOUCHES;
    if (h->has_pace)
        h->touched[PACE] = (h->touched[PACE] + h->slow_pace) / 2;
    h->slow_pace = h->touched[PACE];
    h->has_pace = 1;
    h->touched[TOUCHEDS - 1] = 0;
    for (int i = 0; i < TAXELS; i++)
        h->touched[TOUCHEDS - 1] += !(h->moved[i / 8] >> i % 8 & 1);
    h->touch_status = judge_block(h->touched, FIRST_TOUCHED, TOUCHEDS, h->quiet_status | h->calm_status);
    memset(h->touched, 0, sizeof h->touched);
    memset(h->moved, 0, sizeof h->moved);
    h->touches = 0;
}

/* The end of a tick, of which the detector has found h->since and h->is_new. */
static void finish_tick(touch_health_t *h)
{
    if (h->is_lasting && (h->is_new || h->since <= 1)) {
        h->is_lasting = h->pace_frames = 0;
        if (h->look.frames)
            finish_touch(h);
    }
    if (h->is_new) {
        h->is_lasting = 1;
        h->at_largest = 0;
        h->repeated = 0;
        touch_look_init(&h->look);
    }
    if (!h->tick_frames)
        return;
    for (int k = 0; k < QUIETS; k++) {
        float mean = h->tick[k] / (float)h->tick_frames;
        if (k < CALMS) {
            mean = logf(mean + SLIGHT);
            h->calm[k] = h->calm_ticks ? fminf(h->calm[k], mean) : mean;
        }
        h->quiet[k] += h->is_lasting || h->since ? 0 : mean;
    }
    h->quiet_ticks += !h->is_lasting && !h->since;
    memset(h->tick, 0, sizeof h->tick);
    h->tick_frames = 0;
    if (++h->calm_ticks == CALM_TICKS) {
        h->calm_status = judge_block(h->calm, FIRST_CALM, CALMS, 0);
        h->calm_ticks = 0;
    }
    if (h->quiet_ticks < QUIET_TICKS)
        return;
    for (int k = 0; k < QUIETS; k++)
        h->quiet[k] /= QUIET_TICKS;
    h->quiet_status = judge_block(h->quiet, 0, QUIETS, 0);
    memset(h->quiet, 0, sizeof h->quiet);
    h->quiet_ticks = 0;
}
